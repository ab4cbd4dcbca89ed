"""What a predicted band is about: its kind, and its name in the words of design."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

NESTED = ("device", "new_test", "observation")
"""The law with its level's effect; plus test-to-test scatter; plus a record's offset and noise."""

THIS_TEST = "this_test"
"""One calibrated test by itself: what is known of its own parameters."""

KINDS = (*NESTED, THIS_TEST)

KIND_NAMES: Mapping[str, str] = MappingProxyType(
    {
        "device": "mean property",
        "new_test": "this device tested again",
        "observation": "a measurement of it",
        THIS_TEST: "this very test",
    }
)
"""What each kind is about, in the words of design; the same everywhere."""
