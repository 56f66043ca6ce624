"""Installs dgs_sim_bridge as setup.cfg says."""

from setuptools import setup

setup()
