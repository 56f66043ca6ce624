"""Shaded pictures of objects and hands, drawn with the suite's own rasteriser."""
