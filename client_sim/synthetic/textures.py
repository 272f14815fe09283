"""Procedural textures of the synthetic building, BGR, drawn at a given number of pixels a metre."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.worlds import Texture

Floats = NDArray[np.float32]
Colour = tuple[float, float, float]

_TITLES = """
EXIT LIBRARY STUDIO ARCHIVE MUSEUM CAFE OFFICE SUMMER CONCERT FESTIVAL LECTURE WORKSHOP THEATRE RIVER
FOREST OCEAN WINTER GALLERY MARKET GARDEN NORTH SOUTH EAST WEST PRINT DESIGN CINEMA OPEN
"""
WORDS = tuple(_TITLES.split())
"""What is printed on posters."""

FONTS = (
    cv2.FONT_HERSHEY_SIMPLEX,
    cv2.FONT_HERSHEY_DUPLEX,
    cv2.FONT_HERSHEY_COMPLEX,
    cv2.FONT_HERSHEY_TRIPLEX,
)


def cloud(rng: np.random.Generator, height: int, width: int, cell: int) -> Floats:
    """Smooth noise of zero mean and about unit deviation; ``cell`` pixels is its grain."""
    coarse = rng.normal(size=(height // cell + 3, width // cell + 3)).astype(np.float32)
    size = (coarse.shape[1] * cell, coarse.shape[0] * cell)
    smooth = cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC)
    return np.asarray(smooth[cell : cell + height, cell : cell + width], dtype=np.float32)


def _shaded(colour: Colour, shade: Floats) -> Texture:
    picture = np.asarray(colour, dtype=np.float32) + shade[..., None]
    return picture.clip(0, 255).astype(np.uint8)


def plaster(rng: np.random.Generator, height: int, width: int, colour: Colour) -> Texture:
    """A painted wall: stains, roller marks, grain, and darker towards floor and ceiling."""
    shade = 3.5 * cloud(rng, height, width, 90) + 2.5 * cloud(rng, height, width, 17)
    shade += rng.normal(scale=3.0, size=(height, width)).astype(np.float32)
    edge = np.minimum(np.arange(height), np.arange(height)[::-1]).astype(np.float32)
    shade -= (22.0 * np.exp(-edge / (0.09 * height)))[:, None]
    return _shaded(colour, shade)


def wood(rng: np.random.Generator, height: int, width: int, colour: Colour) -> Texture:
    """Boards with a grain that runs down."""
    grain = cv2.resize(rng.normal(size=(max(2, height // 60), width)).astype(np.float32), (width, height))
    return _shaded(colour, 9.0 * np.asarray(grain, dtype=np.float32) + 4.0 * cloud(rng, height, width, 25))


def tiles(rng: np.random.Generator, height: int, width: int, side: int, colour: Colour) -> Texture:
    """Floor tiles: each its own shade, speckles, dark joints and scuffs."""
    rows, columns = -(-height // side), -(-width // side)
    each = rng.normal(scale=9.0, size=(rows, columns)).astype(np.float32)
    shade = each.repeat(side, axis=0).repeat(side, axis=1)[:height, :width].copy()
    speckles = rng.normal(size=(height, width)).astype(np.float32)
    shade += 5.0 * speckles + 14.0 * (speckles > 2.4) - 16.0 * (speckles < -2.5)
    shade += 4.0 * cloud(rng, height, width, 60)
    joint = max(1, side // 40)
    for k in range(joint):
        shade[k::side] -= 45.0
        shade[:, k::side] -= 45.0
    picture = _shaded(colour, shade)
    for _ in range(height * width // 40_000):
        a = rng.integers(0, (width, height))
        b = a + rng.normal(scale=side / 2, size=2).astype(np.int64)
        dark = tuple(float(c) * rng.uniform(0.5, 0.8) for c in colour)
        cv2.line(picture, _pixel(a), _pixel(b), dark, 1, cv2.LINE_AA)
    return picture


def panels(rng: np.random.Generator, height: int, width: int, side: int) -> Texture:
    """A suspended ceiling: perforated panels, joints, some of them lamps."""
    shade = 3.0 * cloud(rng, height, width, 50)
    dots = rng.random((height, width)) < 0.02
    shade -= 30.0 * cv2.GaussianBlur(dots.astype(np.float32), (3, 3), 0.7) * 2.0
    picture = _shaded((206.0, 210.0, 212.0), np.asarray(shade, dtype=np.float32))
    rows, columns = -(-height // side), -(-width // side)
    for r in range(rows):
        for c in range(columns):
            top, left = r * side, c * side
            kind = rng.random()
            if kind < 0.13:
                cv2.rectangle(
                    picture, (left + 6, top + 6), (left + side - 6, top + side - 6), (250, 252, 252), -1
                )
            elif kind < 0.2:
                centre = (left + side // 2, top + side // 2)
                cv2.circle(picture, centre, side // 6, (120, 122, 125), -1, cv2.LINE_AA)
                cv2.circle(picture, centre, side // 11, (60, 62, 66), 2, cv2.LINE_AA)
    picture[::side] = picture[:, ::side] = 130
    return picture


def _pixel(point: NDArray[np.int64]) -> tuple[int, int]:
    return int(point[0]), int(point[1])


def _bright(rng: np.random.Generator, saturation: tuple[int, int] = (60, 200)) -> Colour:
    hsv = np.array(
        [[[rng.integers(0, 180), rng.integers(*saturation), rng.integers(90, 250)]]], dtype=np.uint8
    )
    b, g, r = cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR)[0, 0]
    return float(b), float(g), float(r)


def _write(picture: Texture, rng: np.random.Generator, text: str, left: int, base: int, width: int) -> None:
    """Text in a random face, fitted to a width in pixels."""
    face = int(rng.choice(FONTS))
    (unit, _), _ = cv2.getTextSize(text, face, 1.0, 2)
    size = width / max(unit, 1)
    ink = tuple(rng.uniform(0, 70, size=3).tolist())
    cv2.putText(picture, text, (left, base), face, size, ink, max(1, round(2.2 * size)), cv2.LINE_AA)


def poster(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A framed print: random shapes over a colour ramp, a title, lines of small text."""
    ramp = np.linspace(0.0, 1.0, height, dtype=np.float32)[:, None, None]
    first, second = (np.asarray(_bright(rng), dtype=np.float32) for _ in range(2))
    paper = 0.35 * (first * (1 - ramp) + second * ramp) + 0.65 * rng.uniform(150, 250)
    picture = np.broadcast_to(paper, (height, width, 3)).clip(0, 255).astype(np.uint8).copy()
    short = min(height, width)
    for _ in range(int(rng.integers(9, 18))):
        colour = _bright(rng)
        x, y = int(rng.uniform(0, width)), int(rng.uniform(0, 0.75 * height))
        size = int(short * rng.uniform(0.05, 0.24))
        kind = rng.integers(0, 4)
        if kind == 0:
            cv2.circle(picture, (x, y), size, colour, -1, cv2.LINE_AA)
        elif kind == 1:
            far = (x + size, y + int(size * rng.uniform(0.4, 1.6)))
            cv2.rectangle(picture, (x, y), far, colour, -1)
        elif kind == 2:
            corners = rng.normal(scale=size, size=(3, 2)) + np.array([x, y])
            cv2.fillPoly(picture, [corners.astype(np.int32)], colour, cv2.LINE_AA)
        else:
            axes = (size, max(2, size // 3))
            cv2.ellipse(picture, (x, y), axes, float(rng.uniform(0, 180)), 0, 360, colour, 3, cv2.LINE_AA)
    _write(picture, rng, str(rng.choice(WORDS)), width // 12, int(0.86 * height), int(0.8 * width))
    for line in range(3):
        text = " ".join(rng.choice(WORDS, size=4)).lower()
        base = int((0.905 + 0.032 * line) * height)
        _write(picture, rng, text, width // 12, base, int(width * rng.uniform(0.55, 0.82)))
    frame = max(2, short // 30)
    shade = float(rng.uniform(20, 90))
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (shade, shade, shade * 1.1), frame)
    return picture


def door(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A closed door with its frame, handle, window and number."""
    tone = float(rng.uniform(0.7, 1.1))
    picture = wood(rng, height, width, (70 * tone, 105 * tone, 150 * tone))
    edge = max(3, width // 14)
    cv2.rectangle(picture, (0, 0), (width - 1, height + edge), (198, 200, 202), edge)
    for top, bottom in ((0.12, 0.42), (0.55, 0.92)):
        cv2.rectangle(
            picture,
            (int(0.2 * width), int(top * height)),
            (int(0.8 * width), int(bottom * height)),
            (45 * tone, 72 * tone, 108 * tone),
            3,
        )
    if rng.random() < 0.5:
        corners = (int(0.3 * width), int(0.16 * height)), (int(0.7 * width), int(0.38 * height))
        cv2.rectangle(picture, *corners, (150, 140, 125), -1)
        cv2.line(picture, corners[0], corners[1], (185, 178, 168), 2, cv2.LINE_AA)
    handle = (int(0.86 * width), int(0.52 * height))
    cv2.circle(picture, handle, max(3, width // 28), (205, 210, 215), -1, cv2.LINE_AA)
    cv2.line(picture, handle, (handle[0] - width // 8, handle[1]), (180, 186, 192), 4, cv2.LINE_AA)
    number = f"{rng.integers(1, 5)}.{rng.integers(10, 99)}"
    plate = (int(0.36 * width), int(0.45 * height)), (int(0.64 * width), int(0.51 * height))
    cv2.rectangle(picture, *plate, (235, 238, 240), -1)
    _write(picture, rng, number, int(0.4 * width), int(0.5 * height), int(0.2 * width))
    return picture


def shelf(rng: np.random.Generator, height: int, width: int) -> Texture:
    """The front of a bookcase: rows of backs in many colours."""
    picture = wood(rng, height, width, (60.0, 88.0, 120.0))
    rows = max(2, height // 75)
    for r in range(rows):
        top, bottom = int((r + 0.08) * height / rows), int((r + 0.92) * height / rows)
        x = width // 40 + 2
        while x < width - 6:
            thick = int(rng.integers(5, 16))
            lean = int((bottom - top) * rng.uniform(0.0, 0.3))
            if rng.random() < 0.9:
                right = min(x + thick, width - 4)
                cv2.rectangle(picture, (x, top + lean), (right, bottom), _bright(rng, (20, 130)), -1)
                cv2.line(picture, (x, top + lean), (x, bottom), (30, 30, 34), 1)
                band = int(rng.uniform(top + lean, bottom))
                cv2.line(picture, (x + 1, band), (right, band), (225, 228, 230), 2)
            x += thick + 1
    return picture


@dataclass(frozen=True, eq=False, slots=True)
class Picture:
    """Something on a wall, metres from the wall's upper left corner."""

    left: float
    top: float
    texture: Texture


def hang(surface: Texture, picture: Picture, pixels_per_metre: float) -> None:
    """Draw a picture into a wall's texture, with a soft shadow below; what sticks out is cut off."""
    x, y = round(picture.left * pixels_per_metre), round(picture.top * pixels_per_metre)
    height, width = picture.texture.shape[:2]
    shadow = surface[max(0, y) : y + height + 6, max(0, x) : x + width + 6]
    shadow[:] = (shadow * 0.72).astype(np.uint8)
    rows = slice(max(0, y), min(surface.shape[0], y + height))
    columns = slice(max(0, x), min(surface.shape[1], x + width))
    surface[rows, columns] = picture.texture[
        rows.start - y : rows.stop - y, columns.start - x : columns.stop - x
    ]
