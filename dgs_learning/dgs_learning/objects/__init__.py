"""Procedural objects: convex building blocks and the catalogues made of them."""
