"""Subcommands of `dgs`, one module each."""
