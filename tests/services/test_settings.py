from __future__ import annotations

import pytest
from pydantic import ValidationError

from server.settings import Settings

LOOPBACK = {"127.0.0.1", "localhost", "[::1]"}


@pytest.mark.parametrize(
    ("host", "more"),
    [
        ("127.0.0.1", set()),
        ("0.0.0.0", set()),  # noqa: S104
        ("::", set()),
        ("192.168.1.5", {"192.168.1.5"}),
        ("FE80::1", {"[fe80::1]"}),
    ],
)
def test_the_service_is_known_by_loopback_names_and_its_address(host: str, more: set[str]) -> None:
    assert Settings(host=host).host_names == LOOPBACK | more


def test_names_come_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PAIRNAVI_ALLOWED_HOSTS", "way.example, Localhost,")
    assert Settings().host_names == {"way.example", "localhost", "127.0.0.1"}


@pytest.mark.parametrize("name", ["*", "http://way.example", "way.example:80", "way.example/x", "::1"])
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(ValidationError):
        Settings(allowed_hosts=(name,))
