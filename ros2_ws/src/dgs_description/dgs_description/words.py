"""Words of sentences: numbers with their nouns, and what is too long to be read."""

from __future__ import annotations


def plural(number: int, noun: str) -> str:
    """E.g. "1 grasp", "2 grasps", "0 pushes"."""
    ending = "es" if noun.endswith("sh") else "s"
    return f"{number} {noun}{'' if number == 1 else ending}"


def shortened(text: str, most: int = 1000) -> str:
    """The text, or its begin and end if it has more than `most` characters: a name that came in may be megabytes."""
    if len(text) <= most:
        return text
    end = most // 4
    return f"{text[: most - end]} [... {len(text) - most} characters ...] {text[-end:]}"
