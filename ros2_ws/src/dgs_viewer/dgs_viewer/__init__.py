"""The live page: what the suite sees, plans and does, in a browser."""
