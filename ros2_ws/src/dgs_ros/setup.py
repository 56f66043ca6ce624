"""Installs dgs_ros as setup.cfg says."""

from setuptools import setup

setup()
