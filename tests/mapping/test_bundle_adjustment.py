"""Window adjustment against its statistics, its own derivative and Ceres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from server.geometry.absolute_pose import CHI2_2DOF_95, pose_jacobian, projection_jacobian
from server.geometry.cameras import Camera
from server.geometry.poses import SE3, quaternion_from_rotation, rotation_from_vector, vector_from_rotation
from server.mapping.bundle_adjustment import BundleProblem, BundleSolution, adjust, squared_errors

CAMERA = Camera.pinhole(640, 480, 500.0, 505.0, 321.0, 238.0)


@dataclass(frozen=True, eq=False)
class Scene:
    """The truth, and the problem made of it: noisy pixels, a start some way off."""

    rotations: np.ndarray
    translations: np.ndarray
    points: np.ndarray
    problem: BundleProblem


def _scene(
    seed: int,
    *,
    cameras: int = 7,
    points: int = 120,
    fixed: int = 2,
    noise: float = 1.0,
    off: float = 1.0,
    outliers: float = 0.0,
) -> Scene:
    """A sideways walk past points 3 to 8 units away; the first ``fixed`` cameras stay at the truth."""
    rng = np.random.default_rng(seed)
    rotations = rotation_from_vector(rng.normal(0, 0.04, (cameras, 3)))
    centres = np.column_stack([np.linspace(0, 2.4, cameras), *rng.normal(0, 0.1, (2, cameras))])
    translations = -np.einsum("cij,cj->ci", rotations, centres)
    rays = rng.uniform([-0.75, -0.35], [0.75, 0.35], (points, 2))
    cloud = np.column_stack([rays, np.ones(points)]) * rng.uniform(3, 8, (points, 1)) + [1.2, 0, 0]
    local = np.einsum("cij,pj->cpi", rotations, cloud) + translations[:, None]
    pixels = CAMERA.project(local)
    seen = ((pixels > 0) & (pixels < [640, 480])).all(axis=2) & (rng.random((cameras, points)) < 0.9)
    enough = seen.sum(axis=0) >= 3
    seen, cloud, pixels = seen[:, enough], cloud[enough], pixels[:, enough]
    camera_index, point_index = np.nonzero(seen)
    sigmas = rng.choice([1.0, 1.7], len(camera_index))
    observed = pixels[camera_index, point_index] + noise * sigmas[:, None] * rng.normal(size=(len(sigmas), 2))
    wrong = rng.random(len(sigmas)) < outliers
    observed[wrong] += rng.choice([-1, 1], (wrong.sum(), 2)) * rng.uniform(15, 60, (wrong.sum(), 2))
    free = np.arange(cameras) >= fixed
    start_r, start_t = rotations.copy(), translations.copy()
    for c in np.flatnonzero(free):
        step = SE3.exp(off * np.concatenate([rng.normal(0, 0.01, 3), rng.normal(0, 0.05, 3)]))
        start_r[c], start_t[c] = (
            (step @ SE3(rotations[c], translations[c])).matrix[:, :3],
            step @ translations[c],
        )
    problem = BundleProblem(
        rotations=start_r,
        translations=start_t,
        free=free,
        points=cloud + off * rng.normal(0, 0.1, cloud.shape),
        camera_index=camera_index,
        point_index=point_index,
        pixels=observed,
        sigmas=sigmas,
        camera=CAMERA,
    )
    return Scene(rotations, translations, cloud, problem)


def _cost(
    problem: BundleProblem, rotations: np.ndarray, translations: np.ndarray, points: np.ndarray
) -> float:
    """Huber's cost, written out."""
    total = 0.0
    for squared in squared_errors(problem, rotations, translations, points):
        inside = squared <= CHI2_2DOF_95
        total += squared if inside else 2 * np.sqrt(CHI2_2DOF_95 * squared) - CHI2_2DOF_95
    return total


def _offset(scene: Scene, solution: BundleSolution) -> np.ndarray:
    """Left perturbations of the free cameras, then moves of the points: from the truth to the solution."""
    turn = solution.rotations @ np.swapaxes(scene.rotations, 1, 2)
    shift = solution.translations - np.einsum("cij,cj->ci", turn, scene.translations)
    cameras = np.concatenate([vector_from_rotation(turn), shift], axis=1)[scene.problem.free]
    return np.concatenate([cameras.ravel(), (solution.points - scene.points).ravel()])


def _information(scene: Scene) -> np.ndarray:
    """Fisher information of the free cameras and the points at the truth, dense."""
    problem = scene.problem
    free = np.flatnonzero(problem.free)
    size = 6 * len(free) + 3 * len(scene.points)
    rotations = scene.rotations[problem.camera_index]
    local = np.einsum("mij,mj->mi", rotations, scene.points[problem.point_index])
    local += scene.translations[problem.camera_index]
    _, by_local = projection_jacobian(local, CAMERA)
    by_camera, by_point = pose_jacobian(local, by_local), by_local @ rotations
    jacobian = np.zeros((len(local), 2, size))
    for m, (c, p) in enumerate(zip(problem.camera_index, problem.point_index, strict=True)):
        if problem.free[c]:
            k = 6 * np.searchsorted(free, c)
            jacobian[m, :, k : k + 6] = by_camera[m] / problem.sigmas[m]
        k = 6 * len(free) + 3 * p
        jacobian[m, :, k : k + 3] = by_point[m] / problem.sigmas[m]
    flat = jacobian.reshape(-1, size)
    return np.asarray(flat.T @ flat)


def test_squared_errors_are_in_units_of_their_variance() -> None:
    scene = _scene(1)
    problem = scene.problem
    found = squared_errors(problem, scene.rotations, scene.translations, scene.points)
    assert found.mean() == pytest.approx(2.0, abs=5 * 2 / np.sqrt(len(found)))
    behind = scene.points.copy()
    behind[0] = scene.points[0] * [1, 1, -1]
    of_it = problem.point_index == 0
    moved = squared_errors(problem, scene.rotations, scene.translations, behind)
    assert np.isinf(moved[of_it]).all()
    np.testing.assert_array_equal(moved[~of_it], found[~of_it])


def test_exact_pixels_give_the_exact_scene() -> None:
    scene = _scene(2, noise=0.0, off=1.0)
    solution = adjust(scene.problem, iterations=40, tolerance=0.0)
    np.testing.assert_allclose(_offset(scene, solution), 0.0, atol=1e-6)
    assert solution.squared_errors.max() < 1e-8


@pytest.mark.parametrize("seed", range(3))
def test_errors_are_as_large_as_the_pixels_allow_and_no_larger(seed: int) -> None:
    """Normalised by the Fisher information they are chi-squared; Huber's weights cost a little."""
    scene = _scene(10 + seed)
    solution = adjust(scene.problem, iterations=30, tolerance=1e-10)
    offset = _offset(scene, solution)
    normalised = offset @ _information(scene) @ offset
    size = len(offset)
    assert chi2.ppf(0.001, size) < normalised < 1.1 * chi2.ppf(0.999, size)
    cameras = 6 * scene.problem.free.sum()
    bound = np.sqrt(np.diag(np.linalg.inv(_information(scene)))[:cameras])
    assert np.sqrt(np.mean((offset[:cameras] / bound) ** 2)) < 1.6


def test_the_default_is_near_the_minimum() -> None:
    """Six steps from a start some pixels off: within a hundredth of the noise's own cost."""
    scene = _scene(3, off=0.5)
    few, many = adjust(scene.problem), adjust(scene.problem, iterations=60, tolerance=1e-12)
    problem = scene.problem
    cost = [_cost(problem, s.rotations, s.translations, s.points) for s in (few, many)]
    assert cost[1] <= cost[0] < 1.01 * cost[1]


def test_the_solution_is_a_minimum_by_finite_differences() -> None:
    scene = _scene(4, outliers=0.05)
    problem = scene.problem
    solution = adjust(problem, iterations=100, tolerance=0.0)
    h = 1e-5

    def along(direction: np.ndarray, length: float) -> float:
        count = 6 * int(problem.free.sum())
        rotations, translations = solution.rotations.copy(), solution.translations.copy()
        for c, step in zip(np.flatnonzero(problem.free), direction[:count].reshape(-1, 6), strict=True):
            moved = SE3.exp(length * step) @ SE3(rotations[c], translations[c])
            rotations[c], translations[c] = moved.rotation, moved.translation
        points = solution.points + length * direction[count:].reshape(-1, 3)
        return _cost(problem, rotations, translations, points)

    rng = np.random.default_rng(0)
    size = 6 * int(problem.free.sum()) + 3 * len(problem.points)
    directions = [*np.eye(size)[:18], *np.eye(size)[-9:], *rng.normal(size=(10, size)) / np.sqrt(size)]
    for direction in directions:
        ahead, here, back = (along(direction, length) for length in (h, 0.0, -h))
        slope, curvature = (ahead - back) / (2 * h), (ahead - 2 * here + back) / h**2
        assert curvature > 0
        # The minimum along the direction is a thousandth of a standard deviation away, at most.
        assert abs(slope) / curvature < 1e-3 / np.sqrt(curvature / 2)


def _ceres(problem: BundleProblem) -> BundleSolution:
    """The same problem solved by pycolmap; all sigmas must be one."""
    reconstruction = pycolmap.Reconstruction()
    reconstruction.add_camera_with_trivial_rig(
        pycolmap.Camera(model="PINHOLE", width=640, height=480, params=list(CAMERA.params), camera_id=1)
    )
    tracks: dict[int, pycolmap.Track] = {}
    config = pycolmap.BundleAdjustmentConfig()
    for c, (rotation, translation) in enumerate(zip(problem.rotations, problem.translations, strict=True)):
        rows = np.flatnonzero(problem.camera_index == c)
        image = pycolmap.Image(name=str(c), keypoints=problem.pixels[rows], camera_id=1, image_id=c + 1)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(quaternion_from_rotation(rotation)), translation)
        reconstruction.add_image_with_trivial_frame(image, pose)
        config.add_image(c + 1)
        if not problem.free[c]:
            config.set_constant_rig_from_world_pose(reconstruction.image(c + 1).frame_id)
        for k, row in enumerate(rows):
            tracks.setdefault(int(problem.point_index[row]), pycolmap.Track()).add_element(c + 1, k)
    identities = {p: reconstruction.add_point3D(problem.points[p], track) for p, track in tracks.items()}
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.HUBER
    options.ceres.loss_function_scale = np.sqrt(CHI2_2DOF_95)
    options.ceres.solver_options.max_num_iterations = 100
    options.ceres.solver_options.function_tolerance = 1e-14
    options.ceres.solver_options.gradient_tolerance = 1e-14
    options.ceres.solver_options.parameter_tolerance = 1e-14
    pycolmap.create_default_bundle_adjuster(options, config, reconstruction).solve()
    poses = [reconstruction.image(c + 1).cam_from_world() for c in range(len(problem.rotations))]
    rotations = Rotation.from_quat([p.rotation.quat for p in poses]).as_matrix()
    translations = np.array([p.translation for p in poses])
    points = np.array([reconstruction.point3D(identities[p]).xyz for p in range(len(problem.points))])
    return BundleSolution(
        rotations, translations, points, squared_errors(problem, rotations, translations, points)
    )


def test_ceres_finds_the_same_minimum() -> None:
    scene = _scene(5, outliers=0.03)
    problem = replace(scene.problem, sigmas=np.ones(len(scene.problem.sigmas)))
    ours, theirs = adjust(problem, iterations=200, tolerance=0.0), _ceres(problem)
    cost = [_cost(problem, s.rotations, s.translations, s.points) for s in (ours, theirs)]
    assert cost[0] == pytest.approx(cost[1], rel=1e-7)
    np.testing.assert_allclose(ours.rotations, theirs.rotations, atol=2e-5)
    np.testing.assert_allclose(ours.translations, theirs.translations, atol=1e-4)
    apart = np.linalg.norm(ours.points - theirs.points, axis=1)
    assert np.median(apart) < 1e-4
    assert apart.max() < 1e-2


def test_fixed_cameras_stay_bit_for_bit() -> None:
    problem = _scene(6, fixed=3).problem
    before = problem.rotations.copy(), problem.translations.copy(), problem.points.copy()
    solution = adjust(problem)
    np.testing.assert_array_equal(solution.rotations[:3], before[0][:3])
    np.testing.assert_array_equal(solution.translations[:3], before[1][:3])
    assert (solution.rotations[3:] != before[0][3:]).any(axis=(1, 2)).all()
    # What went in is left as it was.
    for given, kept in zip((problem.rotations, problem.translations, problem.points), before, strict=True):
        np.testing.assert_array_equal(given, kept)


def test_outliers_neither_pull_nor_hide() -> None:
    clean, spoiled = _scene(8), _scene(8, outliers=0.08)
    problem = spoiled.problem
    wrong = (
        np.abs(
            problem.pixels
            - CAMERA.project(
                np.einsum(
                    "mij,mj->mi", spoiled.rotations[problem.camera_index], spoiled.points[problem.point_index]
                )
                + spoiled.translations[problem.camera_index]
            )
        ).max(axis=1)
        > 12
    )
    assert wrong.sum() > 30
    solution = adjust(problem, iterations=40, tolerance=1e-9)
    cameras = 6 * int(problem.free.sum())
    bound = np.sqrt(np.diag(np.linalg.inv(_information(clean)))[:cameras])
    assert np.sqrt(np.mean((_offset(spoiled, solution)[:cameras] / bound) ** 2)) < 3.0
    assert (solution.squared_errors[wrong] > CHI2_2DOF_95).mean() > 0.97
    assert (solution.squared_errors[~wrong] > CHI2_2DOF_95).mean() < 0.12


def test_a_point_behind_a_camera_does_no_harm() -> None:
    """Its observation is left out while it is behind; the rest is adjusted as without it."""
    scene = _scene(9)
    problem = scene.problem
    spoiled = problem.points.copy()
    spoiled[5] = [1.2, 0.0, -4.0]
    solution = adjust(replace(problem, points=spoiled), iterations=40, tolerance=1e-10)
    keep = problem.point_index != 5
    without = replace(
        problem,
        camera_index=problem.camera_index[keep],
        point_index=problem.point_index[keep],
        pixels=problem.pixels[keep],
        sigmas=problem.sigmas[keep],
    )
    expected = adjust(without, iterations=40, tolerance=1e-10)
    np.testing.assert_allclose(solution.translations, expected.translations, atol=1e-4)
    assert np.isfinite(solution.points).all()
    assert np.isinf(solution.squared_errors[~keep]).all()
