"""The codes that the wire documents are those that the service sends."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from server.api.problems import _DOMAIN_STATUS, _HTTP_CODES
from server.mapping.outcome import BuildStage, BuildStatus
from server.mapping.route_map import ScaleSource
from server.mapping.weak_stretches import WeakReason
from server.navigation.updates import Instruction, NavigationState, RefusalReason
from server.protocol.close_codes import CloseCode
from server.protocol.codes import (
    BuildStageCode,
    FailureCode,
    InstructionCode,
    RefusalCode,
    ScaleSourceCode,
    StateCode,
    WeakStretchCode,
)
from server.protocol.error_codes import ErrorCode
from server.protocol.problem_codes import ProblemCode
from server.services.errors import DomainError, NavigationUnavailableError
from server.services.navigation import EndReason

SERVER = Path(__file__).parents[2] / "server"


def written(pattern: str, *folders: str) -> set[str]:
    """What a pattern's group finds in the code of some folders."""
    files = [file for folder in folders for file in (SERVER / folder).rglob("*.py")]
    return {name for file in files for name in re.findall(pattern, file.read_text(encoding="utf-8"))}


@pytest.mark.parametrize(
    ("documented", "sent"),
    [
        (StateCode, NavigationState),
        (InstructionCode, Instruction),
        (RefusalCode, RefusalReason),
        (ScaleSourceCode, ScaleSource),
        (WeakStretchCode, WeakReason),
    ],
)
def test_codes_of_the_algorithms_are_documented(documented: type[str], sent: type[str]) -> None:
    missing = f"server/protocol/codes.py has other codes than {sent.__name__}"
    assert {str(code) for code in documented} == {str(code) for code in sent}, missing  # type: ignore[attr-defined]


def test_stages_of_builds_are_documented() -> None:
    around = written(r'build_stage="(\w+)"', "services")
    assert {"queued", "finished"} <= around
    assert {str(code) for code in BuildStageCode} == {str(stage) for stage in BuildStage} | around


def test_reasons_of_failed_builds_are_documented() -> None:
    service = written(r'(?:BuildOutcome\(\s*|failure_reason=)"(\w+)"', "services", "workers")
    assert {"timed_out", "gave_up", "video_missing"} <= service
    reasons = {str(status) for status in BuildStatus} - {"ready"}
    assert {str(code) for code in FailureCode} == reasons | service
    assert all(code.advice for code in FailureCode)


def test_problems_are_documented_with_their_status() -> None:
    raised = {error.code: _DOMAIN_STATUS.get(error.code) for error in domain_errors() if error.code}
    # It never leaves the socket.
    del raised[NavigationUnavailableError.code]
    for code, status in {**raised, **_DOMAIN_STATUS, **{c: s for s, c in _HTTP_CODES.items()}}.items():
        assert code in {str(known) for known in ProblemCode}, (
            f"add {code} to server/protocol/problem_codes.py"
        )
        assert ProblemCode(code).status == status
    elsewhere = {"host_not_allowed", "invalid_request", "internal_error"}
    assert {str(code) for code in ProblemCode} == {*_DOMAIN_STATUS, *_HTTP_CODES.values(), *elsewhere}


def domain_errors() -> list[type[DomainError]]:
    """Those that HTTP answers with; those of the socket are caught there."""
    from server.services import errors

    return [
        error
        for error in vars(errors).values()
        if isinstance(error, type) and issubclass(error, DomainError) and error is not DomainError
    ]


def test_every_end_of_a_session_has_its_codes() -> None:
    for reason in EndReason:
        error = ErrorCode(str(reason))
        assert error.in_goodbye
        assert error.close is CloseCode[reason.name]


def test_what_may_be_resumed_is_what_a_pause_or_a_new_connection_heals() -> None:
    assert {code.name for code in CloseCode if code.may_resume} == {
        "IDLE_TIMEOUT",
        "SLOW_CLIENT",
        "INTERNAL_ERROR",
        "GOING_AWAY",
        "BUSY",
    }


def test_codes_are_found_by_their_values() -> None:
    assert CloseCode(4408) is CloseCode.IDLE_TIMEOUT
    assert ErrorCode("bad_hello") is ErrorCode.BAD_HELLO
    assert f"{RefusalCode.AMBIGUOUS}" == "ambiguous"
