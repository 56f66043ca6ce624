"""From candidates to hands that touch: height field, hidden sides, closing, quality, fit."""
