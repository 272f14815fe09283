"""What a navigation process does with a picture: decode it, turn it upright, hand it to its session."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
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
        """
        ...

    def snapshot(self) -> Any:
        """Plain JSON values from which another process goes on."""
        ...


class Engine(Protocol):
    """Opens sessions; one per process."""

    def open(
        self, map_file: str, camera: Mapping[str, Any], orientation: int, snapshot: Any | None
    ) -> EngineSession:
        """A session on a map.

        Raises:
            MapRefused: the map cannot be read.
        """
        ...


class MapSession:
    """A session on a route map; see :class:`EngineSession`.

    Args:
        camera: of the pictures as they come.
        orientation: degrees clockwise by which they have to be turned.
    """

    def __init__(
        self, route_map: RouteMap, camera: Camera, orientation: int, snapshot: Any | None, max_pixels: int
    ) -> None:
        self._camera = camera
        self._turn = _TURNS.get(orientation)
        self._max_pixels = max_pixels
        self._session = NavigationSession(
            route_map,
            camera.rotated(orientation // 90),
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
        update: Update = self._session.process(image, capture_time, sequence)
        return update

    def _check_size(self, width: int, height: int) -> None:
        if (width, height) != (self._camera.width, self._camera.height):
            raise PictureRefused(
                f"the picture is {width}x{height}, its camera {self._camera.width}x{self._camera.height}"
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
        self._maps: OrderedDict[str, RouteMap] = OrderedDict()

    def open(
        self, map_file: str, camera: Mapping[str, Any], orientation: int, snapshot: Any | None
    ) -> MapSession:
        """See :meth:`Engine.open`."""
        return MapSession(
            self._map(map_file), Camera.from_json(camera), orientation, snapshot, self._max_pixels
        )

    def _map(self, map_file: str) -> RouteMap:
        route_map = self._maps.get(map_file)
        if route_map is None:
            try:
                route_map = load_route_map(Path(map_file))
            except (RouteMapFileError, OSError) as error:
                raise MapRefused(str(error)) from None
            self._maps[map_file] = route_map
        self._maps.move_to_end(map_file)
        while len(self._maps) > self._capacity:
            self._maps.popitem(last=False)
        return route_map
