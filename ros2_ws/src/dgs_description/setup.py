"""Installs dgs_description as setup.cfg says."""

from setuptools import setup

setup()
