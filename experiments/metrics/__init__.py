"""Metrics: one file and one YAML each; see `experiments.metrics.metric` for the interface."""
