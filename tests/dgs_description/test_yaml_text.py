"""YAML as people write it."""

import pytest
import yaml

from dgs_description.yaml_text import load_yaml


def test_numbers_with_an_exponent_are_numbers() -> None:
    assert load_yaml("[1e-3, 2E5, -1.5e2, .5e1, 1.e3]") == [0.001, 200000.0, -150.0, 5.0, 1000.0]
    assert load_yaml("[e5, 1e, 0x10, 12, '1e3', 1.5]") == ["e5", "1e", 16, 12, "1e3", 1.5]


def test_a_doubled_key_is_refused_with_its_place() -> None:
    assert load_yaml("[{a: 1}, {a: {a: 2}}]") == [{"a": 1}, {"a": {"a": 2}}]
    for text in ("a: 1\nb: 2\na: 3", "x: {b: 0}\ny:\n  a: 1\n  a: 1"):
        with pytest.raises(yaml.YAMLError, match=r"'a' twice[\s\S]*line [34]"):
            load_yaml(text)
