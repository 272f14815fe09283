"""Writes the parts of the documentation that the code knows better: ``make spec``.

A page marks such a part with ``<!-- generated: name -->`` and ``<!-- end of generated -->``; what lies
between is replaced. ``PARTS`` says what each name gives.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from typing import Any

DOCS = Path(__file__).parent
sys.path[:0] = [str(DOCS.parent), str(DOCS.parent / "tests" / "support")]

from session_script import scripts, shown  # noqa: E402

from server.api.specification import specification  # noqa: E402
from server.protocol.asyncapi import asyncapi_document  # noqa: E402
from server.protocol.close_codes import CloseCode  # noqa: E402
from server.protocol.codes import (  # noqa: E402
    BuildStageCode,
    Code,
    FailureCode,
    InstructionCode,
    RefusalCode,
    StateCode,
    WeakStretchCode,
)
from server.protocol.error_codes import ErrorCode  # noqa: E402
from server.protocol.examples import DOCUMENT_EXAMPLES, MESSAGE_EXAMPLES  # noqa: E402
from server.protocol.frame_layout import HEADER_FIELDS, header_offsets  # noqa: E402
from server.protocol.frames import Frame, encode_frame  # noqa: E402
from server.protocol.problem_codes import ProblemCode  # noqa: E402
from server.protocol.schemas import docstring  # noqa: E402
from server.settings import Settings  # noqa: E402

MARK = re.compile(
    r"(<!-- generated: ([a-z]+)(?: ([\w-]+))? -->\n)(.*?)(<!-- end of generated -->)", re.DOTALL
)


def table(head: Iterable[str], rows: Iterable[Iterable[object]]) -> str:
    """A Markdown table."""
    names = list(head)
    lines = [names, ["---"] * len(names), *rows]
    return "".join(f"| {' | '.join(_cell(cell) for cell in line)} |\n" for line in lines)


def _cell(value: object) -> str:
    return str(value).replace("|", "\\|").replace("\n", " ")


def code_table(codes: type[Code], advice: str) -> str:
    """Codes with what they mean and what to do."""
    return table(("code", "means", advice), ((f"`{c}`", c.meaning, c.advice) for c in codes))


def close_codes() -> str:
    """What a client does on each close."""
    return table(
        ("code", "name", "when", "resume?", "what the client does"),
        (
            (int(c), f"`{c.name.lower()}`", c.meaning, "yes" if c.may_resume else "no", c.advice)
            for c in CloseCode
        ),
    )


def error_codes() -> str:
    """What follows each error."""
    return table(("code", "about", "then"), ((f"`{code}`", code.meaning, _then(code)) for code in ErrorCode))


def _then(code: ErrorCode) -> str:
    if code.close is None:
        return "the connection goes on"
    return f"closed, {int(code.close)}" + (" (told as a goodbye's reason)" if code.in_goodbye else "")


def problem_codes() -> str:
    """What HTTP answers with."""
    return table(("status", "code", "when"), ((c.status, f"`{c}`", c.meaning) for c in ProblemCode))


def header() -> str:
    """The bytes before a picture."""
    return table(
        ("offset", "bytes", "field", "meaning"),
        (
            (offset, field.size, f"`{field.name}`", field.meaning)
            for offset, field in zip(header_offsets(), HEADER_FIELDS, strict=True)
        ),
    )


def header_example() -> str:
    """A whole message, byte by byte."""
    frame = Frame(sequence=7, capture_time_us=1_500_000, payload=b"\xff\xd8\xff")
    message = encode_frame(frame)
    said = {
        "magic": "P N",
        "sequence": frame.sequence,
        "capture_time_us": f"{frame.capture_time_us:,}: 1.5 s",
        "payload_length": len(frame.payload),
    }
    lines = []
    for offset, field in zip(header_offsets(), HEADER_FIELDS, strict=True):
        part = message[offset : offset + field.size]
        value = said.get(field.name, int.from_bytes(part))
        lines.append(f"{offset:2d}  {part.hex(' '):24s}{field.name:16s} {value}\n")
    lines.append(f"{24}  {frame.payload.hex(' '):24s}{'payload':16s} the JPEG; three bytes of it here\n")
    return f"```text\n{''.join(lines)}```\n"


@cache
def schemas() -> dict[str, Any]:
    """Of everything on the wire, by the model's name."""
    openapi = json.loads(specification("openapi"))["components"]["schemas"]
    return {**openapi, **asyncapi_document()["components"]["schemas"]}


def fields(model: str) -> str:
    """A model, field by field."""
    schema = schemas()[model]
    required = schema.get("required", [])
    rows = []
    for name, property_ in schema["properties"].items():
        optional = "" if name in required else ", may be left out"
        const = property_.get("const")
        said = f"`{const}`" if const is not None else property_.get("description", "")
        rows.append((f"`{name}`", _kind(property_) + optional, said))
    return table(("field", "type", "meaning"), rows)


def _kind(schema: dict[str, Any]) -> str:
    if "$ref" in schema:
        return f"`{schema['$ref'].rpartition('/')[2]}`"
    choices = schema.get("anyOf") or schema.get("allOf")
    if choices:
        return " or ".join(_kind(choice) for choice in choices)
    if "enum" in schema:
        return " or ".join(f"`{json.dumps(value)}`" for value in schema["enum"])
    kinds = schema["type"] if isinstance(schema["type"], list) else [schema["type"]]
    words = [_items(schema) if kind == "array" else kind for kind in kinds]
    return " or ".join(words) + _bounds(schema)


def _items(schema: dict[str, Any]) -> str:
    inner = _kind(schema["items"])
    least, most = schema.get("minItems"), schema.get("maxItems")
    count = f"{least} " if least == most and least is not None else ""
    return f"array of {count}{inner}" + (f", at most {most}" if most is not None and not count else "")


def _bounds(schema: dict[str, Any]) -> str:
    low, high = schema.get("minimum", schema.get("exclusiveMinimum")), schema.get("maximum")
    longest = schema.get("maxLength")
    said = ""
    if low is not None and high is not None:
        said = f", {_number(low)} to {_number(high)}"
    elif low is not None:
        said = f", above {low}" if "exclusiveMinimum" in schema else f", at least {low}"
    return said + (f", at most {longest} characters" if longest is not None else "")


def _number(value: float) -> str:
    power = {2**53: "2^53", 2**32 - 1: "2^32 - 1"}
    return power.get(int(value), f"{value:g}" if value < 1e6 else f"{value:,}")


def example(name: str) -> str:
    """A message or document as JSON."""
    document = MESSAGE_EXAMPLES.get(name) or DOCUMENT_EXAMPLES[name]
    return f"```json\n{_wrapped(document)}\n```\n"


def _wrapped(document: dict[str, Any], width: int = 100) -> str:
    """JSON with as much on a line as fits: examples are read, not scrolled."""
    line = "{"
    lines = []
    for index, (name, value) in enumerate(document.items()):
        comma = "," if index + 1 < len(document) else "}"
        part = f"{json.dumps(name)}: {json.dumps(value, ensure_ascii=False)}{comma}"
        if len(line) + len(part) + 1 > width and line.strip("{ "):
            lines.append(line)
            line = f" {part}"
        else:
            line += part if line == "{" else f" {part}"
    return "\n".join([*lines, line])


def endpoints() -> str:
    """The HTTP interface at a glance."""
    rows = []
    for path, operations in json.loads(specification("openapi"))["paths"].items():
        for method, operation in operations.items():
            good = next(status for status in operation["responses"] if status.startswith("2"))
            rows.append((f"`{method.upper()} {path}`", operation["summary"], good))
    return table(("request", "what it does", "answers"), rows)


def sessions() -> str:
    """All example sessions."""
    return "\n".join(session(script.name) for script in scripts())


def session(name: str) -> str:
    """One example session."""
    script = next(script for script in scripts() if script.name == name)
    lines = "\n".join(shown(script))
    return f"### {script.title}\n\n{script.about} (`{script.name}.jsonl`)\n\n```text\n{lines}\n```\n"


def settings() -> str:
    """Every setting with its variable and default."""
    _, said = docstring(Settings)
    prefix = Settings.model_config.get("env_prefix", "")
    rows = []
    for name, field in Settings.model_fields.items():
        default = field.default
        shown_default = "none" if default is None else _setting(default)
        rows.append((f"`{prefix}{name.upper()}`", shown_default, said.get(name, "")))
    return table(("variable", "default", "meaning"), rows)


def _setting(value: object) -> str:
    if isinstance(value, tuple):
        return f"`{','.join(str(part) for part in value)}`"
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


PARTS: dict[str, Callable[..., str]] = {
    "closes": close_codes,
    "endpoints": endpoints,
    "errors": error_codes,
    "example": example,
    "failures": lambda: code_table(FailureCode, "what to do"),
    "fields": fields,
    "header": header,
    "headerexample": header_example,
    "instructions": lambda: code_table(InstructionCode, "what to tell"),
    "problems": problem_codes,
    "refusals": lambda: code_table(RefusalCode, "what to show"),
    "session": session,
    "sessions": sessions,
    "settings": settings,
    "stages": lambda: table(("stage", "means"), ((f"`{c}`", c.meaning) for c in BuildStageCode)),
    "weaknesses": lambda: code_table(WeakStretchCode, "what to do"),
    "states": lambda: code_table(StateCode, "what to show"),
}


def filled(page: str) -> str:
    """A page with its generated parts as the code has them.

    Raises:
        KeyError: the page names a part that there is none of.
    """

    def part(match: re.Match[str]) -> str:
        name, argument = match[2], match[3]
        made = PARTS[name](argument) if argument else PARTS[name]()
        return f"{match[1]}\n{made}\n{match[5]}"

    return MARK.sub(part, page)


def pages() -> list[Path]:
    """All pages of the documentation."""
    return sorted(DOCS.rglob("*.md"))


def main() -> None:
    """Fill every page."""
    for page in pages():
        text = page.read_text(encoding="utf-8")
        made = filled(text)
        if made != text:
            page.write_text(made, encoding="utf-8")
            print(f"wrote {page.relative_to(DOCS.parent)}")


if __name__ == "__main__":
    main()
