"""A route's quality report as its owner sees it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from server.services.errors import MapUnusableError, RouteNotReadyError
from server.services.routes import Download
from server.storage.objects import ObjectMissingError, ObjectStore
from server.storage.records import RouteRecord, quality_objects


def quality_of(route: RouteRecord) -> Mapping[str, Any]:
    """The report as the build left it; it names the files of those of its pictures that were kept.

    Raises:
        RouteNotReadyError: no build has ended that looked at the walk.
    """
    quality: Mapping[str, Any] | None = (route.report or {}).get("quality")
    if quality is not None:
        return _with_kept(quality, quality_objects(route.report))
    because = f": {route.failure_detail}" if route.failure_detail else ""
    raise RouteNotReadyError(f"the route is {route.state} and its walk has not been judged{because}")


def _with_kept(quality: Mapping[str, Any], kept: Mapping[str, str]) -> Mapping[str, Any]:
    def known(name: str | None) -> str | None:
        return name if name in kept else None

    stretches = [{**stretch, "thumbnail": known(stretch["thumbnail"])} for stretch in quality["stretches"]]
    return {**quality, "stretches": stretches, "picture": known(quality["picture"])}


async def quality_file(store: ObjectStore, route: RouteRecord, name: str) -> Download | None:
    """A picture of the report, None if none of this name was kept.

    Raises:
        RouteNotReadyError: as in :func:`quality_of`.
        MapUnusableError: it is gone from the store.
    """
    quality_of(route)
    key = quality_objects(route.report).get(name)
    if key is None:
        return None
    try:
        return Download(await store.size(key), store.read(key))
    except ObjectMissingError:
        raise MapUnusableError("the picture's file is gone: create another route") from None
