"""What a navigation process does with a picture: decode it, turn it upright, hand it to its session."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np

from server.geometry.cameras import Camera
from server.mapping.codec import RouteMapFileError, load_route_map
from server.mapping.route_map import RouteMap
from server.navigation.frames import BadFrameError, decode_frame, jpeg_size
from server.navigation.session import NavigationSession, SessionSnapshot
from server.navigation.updates import Update
from server.workers.navigation_messages import MapRefused, PictureRefused

_TURNS = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}


class EngineSession(Protocol):
    """A session in its process."""

    def process(self, picture: bytes, capture_time: float, sequence: int) -> Update:
        """Answer one picture.

        Raises:
            PictureRefused: it is no JPEG, or not of the camera's size.
            MapRefused: the map was damaged since the session began.
        """
        ...

    def snapshot(self) -> Any:
        """Plain JSON values from which another process goes on."""
        ...


class Engine(Protocol):
    """Opens sessions; one per process."""

    def open(
        self, map_file: str, camera: Mapping[str, Any] | None, orientation: int, snapshot: Any | None
    ) -> EngineSession:
        """A session on a map.

        Raises:
            MapRefused: the map cannot be read.
        """
        ...


class MapSession:
    """A session on a route map; see :class:`EngineSession`.

    Args:
        camera: of the pictures as they come; None if nobody knows.
        orientation: degrees clockwise by which they have to be turned.
        examine: raises MapRefused if the map's file is no longer what it was.
    """

    def __init__(
        self,
        route_map: RouteMap,
        camera: Camera | None,
        orientation: int,
        snapshot: Any | None,
        max_pixels: int,
        examine: Callable[[], object],
    ) -> None:
        self._examine = examine
        self._camera = camera
        self._turn = _TURNS.get(orientation)
        self._max_pixels = max_pixels
        self._session = NavigationSession(
            route_map,
            None if camera is None else camera.rotated(orientation // 90),
            snapshot=None if snapshot is None else SessionSnapshot.from_json(snapshot),
        )

    def process(self, picture: bytes, capture_time: float, sequence: int) -> Update:
        """See :meth:`EngineSession.process`."""
        try:
            # Before anything is decoded: a picture of another size is not worth the time.
            self._check_size(*jpeg_size(picture))
            image = decode_frame(picture, max_pixels=self._max_pixels)
        except BadFrameError as error:
            raise PictureRefused(str(error)) from None
        self._check_size(image.shape[1], image.shape[0])
        if self._turn is not None:
            image = np.asarray(cv2.rotate(image, self._turn), dtype=np.uint8)
        try:
            update: Update = self._session.process(image, capture_time, sequence)
        except Exception:
            # A map's arrays lie in its file: damaged there, they are nonsense here.
            self._examine()
            raise
        return update

    def _check_size(self, width: int, height: int) -> None:
        camera = self._camera
        # Some phones turn their pictures when they are turned on their side.
        if camera is not None and sorted((width, height)) != sorted((camera.width, camera.height)):
            raise PictureRefused(
                f"the picture is {width}x{height}, its camera {camera.width}x{camera.height}"
            )

    def snapshot(self) -> Any:
        """See :meth:`EngineSession.snapshot`."""
        return self._session.snapshot().to_json()


class MapEngine:
    """Sessions on route maps, the most recently used of which stay open; see :class:`Engine`.

    Args:
        maps: how many stay open without a session.
        max_pixels: of a picture.
    """

    def __init__(self, maps: int, max_pixels: int) -> None:
        self._capacity = maps
        self._max_pixels = max_pixels
        self._maps: OrderedDict[str, _OpenMap] = OrderedDict()

    def open(
        self, map_file: str, camera: Mapping[str, Any] | None, orientation: int, snapshot: Any | None
    ) -> MapSession:
        """See :meth:`Engine.open`."""
        return MapSession(
            self._map(map_file),
            None if camera is None else Camera.from_json(camera),
            orientation,
            snapshot,
            self._max_pixels,
            lambda: _load(map_file),
        )

    def _map(self, map_file: str) -> RouteMap:
        known = self._maps.get(map_file)
        if known is None or known.version != _version(map_file):
            self._maps.pop(map_file, None)
            known = self._maps[map_file] = _load(map_file)
        self._maps.move_to_end(map_file)
        while len(self._maps) > self._capacity:
            self._maps.popitem(last=False)
        return known.route_map


@dataclass(frozen=True, eq=False, slots=True)
class _OpenMap:
    route_map: RouteMap
    version: tuple[int, ...] | None


def _version(map_file: str) -> tuple[int, ...] | None:
    """What changes when the file does: a map is never written again, but disks and people do as they like."""
    try:
        status = Path(map_file).stat()
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns


def _load(map_file: str) -> _OpenMap:
    version = _version(map_file)
    try:
        return _OpenMap(load_route_map(Path(map_file)), version)
    except RouteMapFileError as error:
        raise MapRefused(str(error)) from None
    except OSError as error:
        # Not its text, which names the path.
        raise MapRefused(error.strerror or "it cannot be opened") from None
