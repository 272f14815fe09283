from __future__ import annotations

import math

import pytest
from pydantic import ValidationError

from server.protocol.documents import CreateRoute

NAMES = {"name": "To the lab", "start_label": "Door", "destination_label": "Lab"}


@pytest.mark.parametrize(
    "name",
    [
        "Zum Labor",
        "研究室へ",
        "\u05dc\u05de\u05e2\u05d1\u05d3\u05d4",
        "\u0645\u06cc\u200c\u062e\u0648\u0627\u0647\u06cc\u0645",
        "3. Stock → 🚪",
        "  a  ",
    ],
)
def test_names_in_any_script_are_taken(name: str) -> None:
    assert CreateRoute.model_validate({**NAMES, "name": name}).name == name.strip()


@pytest.mark.parametrize("field", list(NAMES))
@pytest.mark.parametrize(
    "character", ["\0", "\x1b", "\n", "\x7f", "\x9b", "\u200b", "\u202e", "\u2066", "\ufeff"]
)
def test_control_and_format_characters_are_refused(field: str, character: str) -> None:
    with pytest.raises(ValidationError, match=rf"U\+{ord(character):04X}"):
        CreateRoute.model_validate({**NAMES, field: f"a{character}b"})


@pytest.mark.parametrize("length", [0.1, 12.5, 100_000.0])
def test_measured_lengths_of_walks_are_taken(length: float) -> None:
    assert CreateRoute.model_validate({**NAMES, "measured_length_m": length}).measured_length_m == length


@pytest.mark.parametrize("length", [0.0, -1.0, 1e-300, 0.099, 100_001.0, math.inf, math.nan])
def test_measured_lengths_that_no_walk_has_are_refused(length: float) -> None:
    with pytest.raises(ValidationError):
        CreateRoute.model_validate({**NAMES, "measured_length_m": length})
