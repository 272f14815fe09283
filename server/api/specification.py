"""The contract for machines, as text: what ``pairnavi spec`` writes and ``docs/`` keeps."""

from __future__ import annotations

import json
from typing import Any, Literal

Specification = Literal["openapi", "asyncapi"]


def specification(kind: Specification) -> str:
    """A document as JSON that is the same on every machine, ending in a line feed."""
    return json.dumps(_document(kind), indent=2, ensure_ascii=False) + "\n"


def _document(kind: Specification) -> dict[str, Any]:
    if kind == "asyncapi":
        from server.protocol.asyncapi import asyncapi_document

        return asyncapi_document()
    from server.api.app import create_app
    from server.settings import Settings

    # The settings of whoever writes it must not matter.
    return create_app(Settings.model_construct()).openapi()
