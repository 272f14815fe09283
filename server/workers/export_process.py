"""The export process: from a map's file to a file of another format."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

from server.services.exports import ExportName


@dataclass(frozen=True, slots=True)
class ExportOrder:
    """What is to be written where: ``folder`` is empty, and stays the caller's."""

    map_file: Path
    name: ExportName
    folder: Path


@dataclass(frozen=True, slots=True)
class ExportDone:
    """The file was written."""

    file: Path


@dataclass(frozen=True, slots=True)
class ExportRefused:
    """The map cannot be used; ``reason`` says why."""

    reason: str


def main(connection: Connection) -> None:
    """Receive one order, send what came of it."""
    connection.send(export(connection.recv()))
    connection.close()


def export(order: ExportOrder) -> ExportDone | ExportRefused:
    """Write a map in another format."""
    from server.mapping.codec import RouteMapFileError, load_route_map
    from server.mapping.exchange.colmap_export import write_colmap
    from server.mapping.exchange.ply import ply_file
    from server.mapping.exchange.tum import tum_trajectory

    try:
        route_map = load_route_map(order.map_file)
    except RouteMapFileError as error:
        return ExportRefused(str(error))
    except FileNotFoundError:
        return ExportRefused("its file is gone")
    file = order.folder / order.name
    if order.name == "colmap.zip":
        model = order.folder / "model"
        write_colmap(route_map, model)
        _zip(model, file)
    elif order.name == "trajectory.tum":
        file.write_text(tum_trajectory(route_map), encoding="utf-8")
    else:
        file.write_bytes(ply_file(route_map))
    return ExportDone(file)


def _zip(folder: Path, file: Path) -> None:
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_file():
                archive.write(path, path.relative_to(folder))
