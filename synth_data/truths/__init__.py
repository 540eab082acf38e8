"""One file per kind of ground truth, named as `dataset.truth` names it; each has a constant `TRUTH`."""
