"""Whole scenes on disk, in the layout of the authors' release (docs/dataset.md)."""
