"""Numbers with their nouns in sentences."""

from __future__ import annotations


def plural(number: int, noun: str) -> str:
    """E.g. "1 grasp", "2 grasps", "0 pushes"."""
    ending = "es" if noun.endswith("sh") else "s"
    return f"{number} {noun}{'' if number == 1 else ending}"
