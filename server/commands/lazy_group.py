"""Groups of commands whose code is loaded when one of them is asked for, and not before."""

from __future__ import annotations

from importlib import import_module
from typing import Any

import typer
from typer.core import TyperGroup


def lazy_group(path: str) -> type[TyperGroup]:
    """A class for ``typer.Typer(cls=...)``: the group's commands are those of the app at ``module:name``.

    The line of help is the group's own, so that listing it loads nothing.
    """

    class LazyGroup(TyperGroup):
        def list_commands(self, ctx: Any) -> list[str]:
            self._load()
            return super().list_commands(ctx)

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            self._load()
            return super().get_command(ctx, cmd_name)

        def _load(self) -> None:
            if not self.commands:
                module, _, name = path.partition(":")
                self.commands = typer.main.get_group(getattr(import_module(module), name)).commands

    return LazyGroup
