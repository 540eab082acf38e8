"""Peers and controls: one method per file, each a frozen dataclass that `experiments/conf/method` configures."""
