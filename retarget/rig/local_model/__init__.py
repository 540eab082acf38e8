"""Local face models on overlapping patches: Chandran et al. 2022, and the anatomical local model of Wu et al. 2016."""
