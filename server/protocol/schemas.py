"""JSON Schemas of the wire's models, in words that need no Python.

What pydantic derives from a model is made fit for both specifications: descriptions come from docstrings,
field by field; a tuple is an array of fixed length, so that the schemas read the same in JSON Schema's
draft 7, which AsyncAPI 3.0 builds on, and in 2020-12, which OpenAPI 3.1 builds on.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable
from typing import Any, Literal

from pydantic import BaseModel
from pydantic.json_schema import models_json_schema

REFERENCE = "#/components/schemas/{model}"

Schema = dict[str, Any]

_ROLE = re.compile(r":[a-z]+:`~?(?:[\w.]*\.)?(\w+)`")
_ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): (.*(?:\n {8,}.*)*)", re.MULTILINE)


def docstring(thing: Any) -> tuple[str, dict[str, str]]:
    """What a docstring says of the whole, and of each attribute, as Markdown."""
    text = inspect.cleandoc(thing.__doc__ or "")
    whole, _, attributes = text.partition("Attributes:\n")
    fields = {
        name: markdown(said) for names, said in _ENTRY.findall(attributes) for name in re.split(r", ", names)
    }
    return markdown(whole.split("\n\nArgs:")[0].split("\n\nRaises:")[0]), fields


def markdown(text: str) -> str:
    """Prose of a docstring (reStructuredText) as Markdown, a paragraph a line."""
    text = _ROLE.sub(r"`\1`", text).replace("``", "`")
    paragraphs = re.split(r"\n\s*\n", text.strip())
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)


def message_schemas(
    received: Iterable[type[BaseModel]], sent: Iterable[type[BaseModel]]
) -> dict[str, Schema]:
    """Schemas of models and all they contain, by name.

    Args:
        received: by the service: fields with a default may be left out.
        sent: by the service: every field is there.
    """
    modes: list[tuple[type[BaseModel], Literal["validation", "serialization"]]] = [
        *((model, "validation") for model in received),
        *((model, "serialization") for model in sent),
    ]
    _, document = models_json_schema(modes, ref_template=REFERENCE)
    schemas: dict[str, Schema] = document["$defs"]
    models = models_within(model for model, _ in modes)
    made = {name: plain(schemas[name], models.get(name)) for name in sorted(schemas)}
    for name in models_within(model for model, mode in modes if mode == "serialization"):
        properties = made[name]["properties"]
        made[name]["required"] = list(properties)
        for property_ in properties.values():
            property_.pop("default", None)
    return made


def plain(schema: Schema, model: type[BaseModel] | None = None) -> Schema:
    """A model's schema as pydantic writes it, in plain words.

    Args:
        model: whose docstring describes it and its fields; None leaves descriptions as they are.
    """
    schema = _simplified(schema)
    if model is None:
        return schema
    schema["title"] = model.__name__
    schema["description"], fields = docstring(model)
    for name, property_ in schema.get("properties", {}).items():
        if name in fields:
            schema["properties"][name] = _described(property_, fields[name])
    return schema


def models_within(annotations: Iterable[Any]) -> dict[str, type[BaseModel]]:
    """The models in some types, and all that their fields hold, by name."""
    found: dict[str, type[BaseModel]] = {}
    waiting = [model for annotation in annotations for model in _models_in(annotation)]
    while waiting:
        model = waiting.pop()
        if model.__name__ not in found:
            found[model.__name__] = model
            waiting += [
                inner for field in model.model_fields.values() for inner in _models_in(field.annotation)
            ]
    return found


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if inspect.isclass(annotation) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in getattr(annotation, "__args__", ()) for model in _models_in(argument)]


def _described(schema: Schema, description: str) -> Schema:
    if "$ref" in schema:
        # Beside a reference nothing counts in draft 7.
        return {"allOf": [schema], "description": description}
    return {**schema, "description": description}


def _simplified(schema: Any) -> Any:
    """Without generated titles, tuples as arrays, null as a type, whole bounds of integers as such."""
    if isinstance(schema, list):
        return [_simplified(item) for item in schema]
    if not isinstance(schema, dict):
        return schema
    made: Schema = {
        key: {name: _simplified(inner) for name, inner in value.items()}
        if key == "properties"
        else _simplified(value)
        for key, value in schema.items()
        if key != "title"
    }
    items = made.pop("prefixItems", None)
    if items:
        if any(item != items[0] for item in items):
            raise ValueError(f"a tuple of different types cannot be told in draft 7: {schema}")
        made["items"] = items[0]
    for bound in ("minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"):
        value = made.get(bound)
        if isinstance(value, float) and value.is_integer():
            made[bound] = int(value)
    return _nullable(made)


def _nullable(schema: Schema) -> Schema:
    """``anyOf`` of one plain type and null as that type or null."""
    choices = schema.get("anyOf", [])
    others = [choice for choice in choices if choice != {"type": "null"}]
    if len(choices) == 2 and len(others) == 1 and isinstance(others[0].get("type"), str):
        rest = {key: value for key, value in schema.items() if key != "anyOf"}
        kind = {key: value for key, value in others[0].items() if key != "type"}
        return {"type": [others[0]["type"], "null"], **kind, **rest}
    return schema
