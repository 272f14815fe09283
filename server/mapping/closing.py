"""Closing a map: revisits become constraints, drift is spread, the same point of the world becomes one."""

from __future__ import annotations

import numpy as np

from server.geometry.poses import SE3, Sim3
from server.mapping.pose_graph import Edge, optimise
from server.mapping.revisits import Revisit, RevisitOptions, find_revisits
from server.mapping.working_map import WorkingMap


def close_map(working: WorkingMap, options: RevisitOptions | None = None) -> list[Revisit]:
    """Find the revisits of a walk, bend the map so that they fit, and merge what they show twice.

    Returns:
        The revisits, in the order of the walk; none leaves the map as it was.
    """
    revisits = find_revisits(working, list(range(len(working.keyframes))), working, options)
    if revisits:
        bend(working, revisits)
        for revisit in revisits:
            working.merge(revisit.later, revisit.earlier)
    return revisits


def bend(working: WorkingMap, revisits: list[Revisit]) -> None:
    """Move keyframes and landmarks so that the revisits hold and the drift lies evenly between."""
    before = [_similarity(kf.camera_from_world) for kf in working.keyframes]
    edges = [_edge(before, k - step, k) for step in (1, 2) for k in range(step, len(before))]
    for revisit in revisits:
        # The keyframe as the earlier part of the map sees it, from the place it was found near.
        there = revisit.earlier_from_later.compose(before[revisit.keyframe])
        measured = before[revisit.place].inverse().compose(there)
        edges.append(Edge(revisit.place, revisit.keyframe, measured, revisit.depth, weight=2.0))
    after = optimise(before, edges)
    moved = [new.compose(old.inverse()) for new, old in zip(after, before, strict=True)]
    for kf, node in zip(working.keyframes, after, strict=True):
        kf.camera_from_world = SE3(node.rotation, node.translation).inverse()
    born = np.clip(working.born, 0, len(moved) - 1)
    scale = np.array([m.scale for m in moved])[born]
    rotation = np.stack([m.rotation for m in moved])[born]
    translation = np.stack([m.translation for m in moved])[born]
    turned = np.einsum("pij,pj->pi", rotation, working.position)
    working.position = scale[:, None] * turned + translation


def _similarity(camera_from_world: SE3) -> Sim3:
    pose = camera_from_world.inverse()
    return Sim3(1.0, pose.rotation, pose.translation)


def _edge(nodes: list[Sim3], a: int, b: int) -> Edge:
    measured = nodes[a].inverse().compose(nodes[b])
    return Edge(a, b, measured, max(float(np.linalg.norm(measured.translation)), 1e-6))
