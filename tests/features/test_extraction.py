"""ORB: where features are said to be, how they are spread, and images that have none."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from server.features.extraction import Features, OrbExtractor, OrbOptions, spread

Image = NDArray[np.uint8]


def _texture(seed: int = 0, shape: tuple[int, int] = (480, 640)) -> Image:
    """Random blocks of several sizes: corners everywhere."""
    rng = np.random.default_rng(seed)
    picture = np.zeros(shape)
    for size in (4, 10, 24):
        rows, columns = (-(-n // size) for n in shape)
        blocks = np.kron(rng.uniform(0, 80, (rows, columns)), np.ones((size, size)))
        picture += blocks[: shape[0], : shape[1]]
    return picture.astype(np.uint8)


def _dots(width: int, height: int, centres: np.ndarray, radius: float) -> Image:
    """Dark round dots on grey, their centres (N, 2) in COLMAP's pixel convention."""
    u, v = np.arange(width) + 0.5, np.arange(height) + 0.5
    across = np.exp(-0.5 * ((u - centres[:, :1]) / radius) ** 2)
    down = np.exp(-0.5 * ((v - centres[:, 1:]) / radius) ** 2)
    return np.asarray(200 - 150 * np.clip(down.T @ across, 0, 1)).round().astype(np.uint8)


def _offsets_of_dots(width: int, height: int, octave: int, seed: int) -> np.ndarray:
    """(M, 2) features of one octave minus the dots they lie on, in pixels of that octave."""
    rng = np.random.default_rng(seed)
    extractor = OrbExtractor(OrbOptions(count=5000))
    scale = extractor.scale_factor**octave
    gap, margin = int(18 * scale) + 6, 32 * scale + 6
    offsets = []
    for _ in range(1 + octave):
        grid = np.meshgrid(np.arange(margin, width - margin, gap), np.arange(margin, height - margin, gap))
        centres = np.stack(grid, axis=-1).reshape(-1, 2)
        centres += rng.uniform(0, 0.3 * gap, centres.shape)
        features = extractor.extract(_dots(width, height, centres, scale))
        pixels = features.pixels[features.octaves == octave]
        difference = pixels[:, None] - centres
        nearest = np.linalg.norm(difference, axis=2).argmin(axis=1)
        offset = difference[np.arange(len(pixels)), nearest] / scale
        offsets.append(offset[np.linalg.norm(offset, axis=1) < 3.0])
    return np.concatenate(offsets)


@pytest.mark.parametrize(
    ("octave", "size"),
    [(0, 640), (1, 600), (2, 576), (3, 432), (4, 622), (5, 622), (6, 597), (7, 645)],
)
def test_every_octave_keeps_the_pixel_convention(octave: int, size: int) -> None:
    """Sizes that are a whole number of the octave's pixels: nothing is rounded."""
    offset = _offsets_of_dots(size, size, octave, seed=octave)
    assert len(offset) > 50
    assert np.abs(offset.mean(axis=0)).max() < 0.12


@pytest.mark.parametrize("octave", range(8))
def test_the_working_size_biases_no_octave(octave: int) -> None:
    offset = _offsets_of_dots(640, 480, octave, seed=20 + octave)
    assert len(offset) > 50
    assert np.abs(offset.mean(axis=0)).max() < 0.12


def test_features_are_complete() -> None:
    extractor = OrbExtractor(OrbOptions(count=700))
    features = extractor.extract(_texture())
    assert len(features) == 700
    assert features.pixels.shape == (700, 2)
    assert features.pixels.dtype == np.float64
    assert features.descriptors.shape == (700, 32)
    assert features.descriptors.dtype == np.uint8
    assert features.octaves.min() == 0
    assert features.octaves.max() < extractor.levels
    assert (features.angles >= 0).all()
    assert (features.angles < 2 * np.pi + 1e-6).all()
    assert (features.pixels > 0).all()
    assert (features.pixels < [640, 480]).all()


def test_the_same_image_gives_the_same_features() -> None:
    first, again = (OrbExtractor().extract(_texture(1)) for _ in range(2))
    np.testing.assert_array_equal(first.pixels, again.pixels)
    np.testing.assert_array_equal(first.descriptors, again.descriptors)


def test_no_feature_where_the_mask_is() -> None:
    mask = np.zeros((480, 640), bool)
    mask[100:300, 200:500] = True
    free = OrbExtractor(OrbOptions(count=5000)).extract(_texture(2))
    masked = OrbExtractor(OrbOptions(count=5000)).extract(_texture(2), mask)

    def inside(features: Features) -> NDArray[np.bool_]:
        """Well inside: a rim of the rounding of one coarse pixel is left out."""
        x, y = features.pixels.T
        return (x > 202) & (x < 498) & (y > 102) & (y < 298)

    assert inside(free).sum() > 500
    assert inside(masked).sum() == 0
    # Elsewhere everything is still there.
    x, y = free.pixels.T
    outside = (x < 198) | (x > 502) | (y < 98) | (y > 302)
    assert len(masked) >= 0.95 * outside.sum()
    assert len(OrbExtractor().extract(_texture(2), np.ones((480, 640), bool))) == 0


@pytest.mark.parametrize("grey", [0, 128, 255])
def test_a_uniform_image_has_no_features(grey: int) -> None:
    features = OrbExtractor().extract(np.full((480, 640), grey, np.uint8))
    assert len(features) == 0
    assert features.descriptors.shape == (0, 32)
    assert features.pixels.shape == (0, 2)


def test_corners_too_near_the_edge_to_describe_are_left_out() -> None:
    picture = np.full((480, 640), 128, np.uint8)
    picture[:6, :6] = 0
    assert len(OrbExtractor().extract(picture)) == 0


def test_a_faint_half_of_the_image_gets_its_share() -> None:
    """Where the strongest corners are all on one side, the bare wall beside it still gets some.

    As far as the candidates reach: this picture has more corners than a real one.
    """
    picture = _texture(3)
    picture[:, 320:] = 120 + picture[:, 320:] // 6
    spread_out = OrbExtractor(OrbOptions(count=600, candidates=20_000)).extract(picture)
    share = (spread_out.pixels[:, 0] > 330).mean()
    assert share > 0.3


def test_features_are_selected_by_mask_and_by_index() -> None:
    features = OrbExtractor(OrbOptions(count=50)).extract(_texture(4))
    chosen = features.select(np.array([4, 2]))
    np.testing.assert_array_equal(chosen.pixels, features.pixels[[4, 2]])
    assert len(features.select(features.octaves == 0)) == (features.octaves == 0).sum()
    assert len(Features.empty()) == 0


def test_spread_takes_the_best_of_every_cell_first() -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform([0, 0], [640, 480], (3000, 2)).astype(np.float32)
    # One corner of the image is far stronger than all the rest.
    strength = rng.uniform(0, 1, 3000) + 10.0 * (points < 100).all(axis=1)
    cells = (points[:, 1] // 32).astype(int) * 100 + (points[:, 0] // 32).astype(int)
    occupied = np.unique(cells)
    chosen = spread(points, strength, 400, 32)
    assert len(chosen) == len(np.unique(chosen)) == 400
    assert set(cells[chosen]) == set(occupied)
    counts = np.bincount(cells[chosen], minlength=cells.max() + 1)
    everything = np.bincount(cells, minlength=cells.max() + 1)
    for cell in occupied:
        mine = strength[chosen[cells[chosen] == cell]]
        left = np.setdiff1d(np.flatnonzero(cells == cell), chosen)
        if len(left):
            assert mine.min() >= strength[left].max()
    # No cell is two ahead of a cell that still has something to give.
    could = counts[occupied] < everything[occupied]
    assert counts.max() - counts[occupied][could].min() <= 1


def test_spread_prefers_the_stronger_of_one_rank() -> None:
    points = np.array([[5, 5], [50, 5], [100, 5], [6, 6]], np.float32)
    np.testing.assert_array_equal(spread(points, np.array([3.0, 1.0, 2.0, 9.0]), 2, 32), [3, 2])


def test_spread_keeps_everything_when_there_is_room() -> None:
    points = np.zeros((4, 2), np.float32)
    np.testing.assert_array_equal(spread(points, np.ones(4), 4, 32), np.arange(4))
