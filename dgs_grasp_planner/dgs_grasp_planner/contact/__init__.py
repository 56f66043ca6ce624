"""From candidates to hands that touch: height field, completion, closing, quality, fit."""
