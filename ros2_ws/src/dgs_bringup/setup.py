"""Installs dgs_bringup as setup.cfg says."""

from setuptools import setup

setup()
