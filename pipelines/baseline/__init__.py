"""The thesis's algorithms as written: plain2d and plain3d, from which `variants/thesis/` makes its configurations."""
