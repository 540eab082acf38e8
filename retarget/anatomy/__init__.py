"""The volumetric head: skull from soft-tissue depths, tetrahedra of soft and muscle tissue, and the fit to a face."""
