"""A user's own meshes, `identity/expression.obj|ply|npz` in one topology, as a dataset."""
