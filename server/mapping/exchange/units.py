"""The unit in which a map is written for others: metres where its scale is known."""

from __future__ import annotations

from server.mapping.route_map import RouteMap


def export_scale(route_map: RouteMap) -> float:
    """Written units per map unit: metres if the scale is known, else the map's own unit."""
    metres = route_map.scale.metres_per_unit
    return 1.0 if metres is None else metres


def unit_in_words(route_map: RouteMap) -> str:
    """What the written lengths are, for comments and headers."""
    if route_map.scale.metres_per_unit is None:
        return (
            "map units (what the leader walked in a second on average); how many metres that is, is unknown"
        )
    return f"metres (scale from: {route_map.scale.source})"
