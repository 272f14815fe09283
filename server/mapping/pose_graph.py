"""Pose graph of similarities: spreads the drift that a revisit shows over the walk between.

Strasdat, Montiel, Davison, "Scale drift-aware large scale monocular SLAM" (2010): monocular drift is a
drift of scale too, so every keyframe gets a similarity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.sparse import lil_array

from server.geometry.poses import Sim3, rotation_from_vector, vector_from_rotation

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class Edge:
    """A measured similarity ``a_from_b`` between two nodes.

    Attributes:
        a, b: the nodes.
        length: what a translation error is counted in: the edge's own scale, units of frame a.
        weight: inverse standard deviation relative to an ordinary step of the walk.
    """

    a: int
    b: int
    a_from_b: Sim3
    length: float
    weight: float = 1.0


ROTATION_SIGMA = float(np.deg2rad(0.5))
TRANSLATION_SIGMA = 0.03
SCALE_SIGMA = 0.03


def optimise(nodes: list[Sim3], edges: list[Edge]) -> list[Sim3]:
    """Least-squares ``world_from_node`` of all nodes; the first one stays.

    Args:
        nodes: starting values.
    """
    rotations = np.stack([n.rotation for n in nodes])
    translations = np.stack([n.translation for n in nodes])
    scales = np.array([n.scale for n in nodes])
    a, b = np.array([e.a for e in edges]), np.array([e.b for e in edges])
    measured_rotation = np.stack([e.a_from_b.rotation for e in edges])
    measured_translation = np.stack([e.a_from_b.translation for e in edges])
    measured_scale = np.array([e.a_from_b.scale for e in edges])
    length = np.array([e.length for e in edges])
    weight = np.array([e.weight for e in edges])

    def applied(x: Array) -> tuple[Array, Array, Array]:
        step = np.concatenate([np.zeros((1, 7)), x.reshape(-1, 7)])
        return (
            rotation_from_vector(step[:, :3]) @ rotations,
            translations + step[:, 3:6],
            scales * np.exp(step[:, 6]),
        )

    def residuals(x: Array) -> Array:
        r, t, s = applied(x)
        back = r[a].transpose(0, 2, 1)
        relative_rotation = back @ r[b]
        relative_translation = np.einsum("eij,ej->ei", back, t[b] - t[a]) / s[a, None]
        turned = measured_rotation.transpose(0, 2, 1) @ relative_rotation
        out = np.concatenate(
            [
                vector_from_rotation(turned) / ROTATION_SIGMA,
                (relative_translation - measured_translation) / (TRANSLATION_SIGMA * length[:, None]),
                (np.log(s[b] / s[a] / measured_scale) / SCALE_SIGMA)[:, None],
            ],
            axis=1,
        )
        return np.asarray((out * weight[:, None]).ravel())

    pattern = lil_array((7 * len(edges), 7 * len(nodes)), dtype=np.int8)
    for row, edge in enumerate(edges):
        for node in (edge.a, edge.b):
            pattern[7 * row : 7 * row + 7, 7 * node : 7 * node + 7] = 1
    solution = least_squares(
        residuals,
        np.zeros(7 * (len(nodes) - 1)),
        jac_sparsity=pattern.tocsr()[:, 7:],
        method="trf",
        x_scale="jac",
        max_nfev=40,
    )
    r, t, s = applied(solution.x)
    return [Sim3(float(s[i]), r[i], t[i]) for i in range(len(nodes))]
