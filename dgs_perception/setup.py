"""Installs dgs_perception as setup.cfg says."""

from setuptools import setup

setup()
