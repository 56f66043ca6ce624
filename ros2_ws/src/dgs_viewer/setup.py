"""Installs dgs_viewer as setup.cfg says."""

from setuptools import setup

setup()
