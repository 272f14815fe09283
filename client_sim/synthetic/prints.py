"""What hangs on the walls of an office: notices, pictures, boards, signs, plates, windows. BGR."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from client_sim.synthetic.textures import FONTS, WORDS, Colour, cloud, plaster, poster, wood
from client_sim.synthetic.worlds import Texture

WHITE: Colour = (246.0, 248.0, 248.0)
GREEN: Colour = (88.0, 140.0, 34.0)
BLUE: Colour = (150.0, 84.0, 30.0)


def lettering(
    picture: Texture, text: str, box: tuple[float, float, float, float], colour: Colour, face: int = 0
) -> None:
    """Text in the middle of a box (left, top, right, bottom), parts of the picture, as large as fits."""
    height, width = picture.shape[:2]
    left, top, right, bottom = (
        part * side for part, side in zip(box, (width, height, width, height), strict=True)
    )
    (wide, tall), _ = cv2.getTextSize(text, FONTS[face], 1.0, 2)
    size = min((right - left) / wide, (bottom - top) / tall)
    base = (int((left + right - size * wide) / 2), int((top + bottom + size * tall) / 2))
    cv2.putText(picture, text, base, FONTS[face], size, colour, max(1, round(2.4 * size)), cv2.LINE_AA)


def _sheet(height: int, width: int, colour: Colour) -> Texture:
    return np.full((height, width, 3), colour, dtype=np.float64).astype(np.uint8)


def notice(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A printed sheet: a heading, paragraphs too small to read, sometimes a picture or a table."""
    tone = rng.uniform(225, 250)
    picture = _sheet(height, width, (tone * rng.uniform(0.93, 1.0), tone, tone))
    words = rng.choice(WORDS, size=2)
    ink = tuple(float(c) for c in rng.uniform(0, 120, size=3))
    lettering(picture, " ".join(words), (0.08, 0.05, 0.92, 0.13), ink, int(rng.integers(4)))  # type: ignore[arg-type]
    line, row = max(2, height // 45), int(0.19 * height)
    while row < 0.93 * height:
        kind = rng.random()
        if kind < 0.12 and row < 0.65 * height:
            tall = int(rng.uniform(0.12, 0.25) * height)
            block = picture[row : row + tall, int(0.1 * width) : int(rng.uniform(0.5, 0.9) * width)]
            block[:] = (block * rng.uniform(0.3, 0.8, size=3)).astype(np.uint8)
            row += tall + line
        elif kind < 0.22:
            row += 2 * line
        else:
            end = int(width * rng.uniform(0.5, 0.92))
            for start in range(int(0.09 * width), end, max(3, width // 14)):
                stop = min(end, start + int(rng.uniform(0.4, 0.9) * width / 14) + 1)
                cv2.line(picture, (start, row), (stop, row), (70, 70, 74), max(1, line // 3))
            row += line + max(1, line // 2)
    return picture


def landscape(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A framed view: sky, hills behind each other, a sun or trees."""
    ramp = np.linspace(0, 1, height)[:, None, None]
    sky = np.array([rng.uniform(170, 240), rng.uniform(150, 215), rng.uniform(120, 230)])
    glow = np.array([rng.uniform(120, 220), rng.uniform(190, 230), rng.uniform(200, 250)])
    picture = np.broadcast_to(sky * (1 - ramp) + glow * ramp, (height, width, 3)).astype(np.uint8).copy()
    sun = (int(rng.uniform(0.15, 0.85) * width), int(rng.uniform(0.1, 0.4) * height))
    cv2.circle(picture, sun, int(0.07 * width), (225, 240, 252), -1, cv2.LINE_AA)
    columns = np.arange(width)
    for layer in range(int(rng.integers(3, 6))):
        base = height * (0.42 + 0.14 * layer)
        waves: NDArray[np.float64] = np.sum(
            [
                rng.uniform(0.2, 1.0) / k * np.sin(columns / width * k * 6.3 + rng.uniform(0, 6.3))
                for k in (1, 2, 4, 7, 13)
            ],
            axis=0,
        )
        top = (base - 0.06 * height * waves).astype(int).clip(0, height - 1)
        tone = 0.85 - 0.15 * layer
        colour = np.array([rng.uniform(60, 150), rng.uniform(80, 160), rng.uniform(40, 130)]) * tone
        picture[np.arange(height)[:, None] >= top[None, :]] = colour.astype(np.uint8)
        for _ in range(int(rng.integers(0, 9))):
            at = int(rng.integers(0, width))
            tall = int(height * rng.uniform(0.04, 0.12))
            tip = np.array(
                [[at, top[at] - tall], [at - tall // 3, top[at] + 3], [at + tall // 3, top[at] + 3]]
            )
            cv2.fillPoly(picture, [tip.astype(np.int32)], (colour * 0.6).tolist(), cv2.LINE_AA)
    grain = 5 * cloud(rng, height, width, 4)
    picture = (picture + grain[..., None]).clip(0, 255).astype(np.uint8)
    edge = max(2, min(height, width) // 22)
    shade = float(rng.choice([30, 60, 200]))
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (shade, shade * 1.05, shade * 1.1), edge)
    return picture


def board(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A cork board with sheets and cards pinned to it."""
    picture = plaster(rng, height, width, (95.0, 140.0, 180.0))
    speckle = 14 * cloud(rng, height, width, 2)
    picture = (picture + speckle[..., None]).clip(0, 255).astype(np.uint8)
    for _ in range(max(4, int(width / height * 7))):
        tall = int(height * rng.uniform(0.2, 0.42))
        wide = int(tall * rng.choice([0.7, 0.7, 1.4, 1.0]))
        row = int(rng.uniform(0.04, 0.95) * (height - tall))
        column = int(rng.uniform(0.02, 0.98) * max(1, width - wide))
        make = notice if rng.random() < 0.75 else landscape
        sheet = make(rng, tall, wide)[: height - row, : width - column]
        picture[row + 2 : row + 4 + tall, column + 2 : column + 4 + wide] //= 2
        picture[row : row + tall, column : column + wide] = sheet
        cv2.circle(
            picture, (column + wide // 2, row + 4), max(2, height // 90), (40, 40, 200), -1, cv2.LINE_AA
        )
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (120, 150, 170), max(3, height // 30))
    return picture


def whiteboard(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A white board with somebody's drawings."""
    picture = _sheet(height, width, (238.0, 240.0, 240.0))
    for _ in range(int(rng.integers(7, 14))):
        ink = [(60, 40, 30), (170, 60, 30), (40, 40, 190), (60, 130, 40)][int(rng.integers(4))]
        x, y = int(rng.uniform(0.05, 0.8) * width), int(rng.uniform(0.1, 0.85) * height)
        kind = rng.integers(3)
        if kind == 0:
            size = rng.uniform(0.5, 1.1) * height / 250
            text = str(rng.choice(WORDS)).lower()
            cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SCRIPT_SIMPLEX, size, ink, 2, cv2.LINE_AA)
        elif kind == 1:
            far = (x + int(rng.uniform(0.08, 0.25) * width), y + int(rng.uniform(0.08, 0.2) * height))
            cv2.rectangle(picture, (x, y), far, ink, 2, cv2.LINE_AA)
        else:
            far = (x + int(rng.uniform(-0.2, 0.2) * width), y + int(rng.uniform(-0.2, 0.2) * height))
            cv2.arrowedLine(picture, (x, y), far, ink, 2, cv2.LINE_AA, 0, 0.12)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (165, 168, 170), max(3, height // 40))
    return picture


def arrow(picture: Texture, box: tuple[float, float, float, float], towards: str, colour: Colour) -> None:
    """An arrow in a box: ``left``, ``right``, ``up`` or ``down``."""
    shape = np.array([[0.5, 0.0], [1.0, 0.5], [0.65, 0.5], [0.65, 1.0], [0.35, 1.0], [0.35, 0.5], [0.0, 0.5]])
    turns = {"up": 0, "right": 1, "down": 2, "left": 3}[towards]
    for _ in range(turns):
        shape = np.stack([1.0 - shape[:, 1], shape[:, 0]], axis=1)
    height, width = picture.shape[:2]
    low, high = np.array(box[:2]) * (width, height), np.array(box[2:]) * (width, height)
    side = float((high - low).min())
    corners = (low + high - side) / 2 + shape * side
    cv2.fillPoly(picture, [corners.round().astype(np.int32)], colour, cv2.LINE_AA)


def direction_sign(rows: tuple[tuple[str, str], ...], height: int, width: int) -> Texture:
    """White on blue: an arrow and a word a row."""
    picture = _sheet(height, width, BLUE)
    for k, (towards, text) in enumerate(rows):
        top, bottom = (k + 0.15) / len(rows), (k + 0.85) / len(rows)
        side = (bottom - top) * height / width
        arrow(picture, (0.04, top, 0.04 + side, bottom), towards, WHITE)
        lettering(picture, text, (0.1 + side, top + 0.06, 0.95, bottom - 0.06), WHITE, 1)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (210, 214, 216), max(2, height // 40))
    return picture


def exit_sign(towards: str, height: int, width: int) -> Texture:
    """White on green: somebody leaving, an arrow."""
    picture = _sheet(height, width, GREEN)
    head = (int(0.3 * width), int(0.24 * height))
    cv2.circle(picture, head, max(2, height // 11), WHITE, -1, cv2.LINE_AA)
    limbs = ((0.3, 0.36, 0.27, 0.6), (0.27, 0.6, 0.38, 0.86), (0.27, 0.6, 0.15, 0.84), (0.3, 0.4, 0.42, 0.52))
    for x0, y0, x1, y1 in (*limbs, (0.3, 0.4, 0.17, 0.5)):
        ends = (int(x0 * width), int(y0 * height)), (int(x1 * width), int(y1 * height))
        cv2.line(picture, *ends, WHITE, max(2, height // 9), cv2.LINE_AA)
    arrow(picture, (0.55, 0.22, 0.93, 0.78), towards, WHITE)
    return picture


def plate(text: str, height: int, width: int) -> Texture:
    """A room's number, dark on light."""
    picture = _sheet(height, width, (226.0, 229.0, 230.0))
    lettering(picture, text, (0.1, 0.15, 0.9, 0.6), (40.0, 36.0, 34.0), 1)
    cv2.line(
        picture, (width // 8, int(0.78 * height)), (int(0.7 * width), int(0.78 * height)), (120, 118, 116), 2
    )
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (150, 152, 154), 2)
    return picture


def numeral(text: str, height: int, width: int, colour: Colour, ground: Colour) -> Texture:
    """A storey's number, large."""
    picture = _sheet(height, width, ground)
    lettering(picture, text, (0.15, 0.12, 0.85, 0.88), colour, 1)
    return picture


def window(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A window with a bar across, and bright daylight over roofs and trees."""
    picture = landscape(rng, height, width)
    picture = (255 - (255 - picture.astype(np.float32)) * 0.45).astype(np.uint8)
    frame = max(4, width // 28)
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (228, 230, 232), 2 * frame)
    cv2.line(picture, (width // 2, 0), (width // 2, height), (222, 224, 226), frame)
    cv2.line(picture, (0, int(0.68 * height)), (width, int(0.68 * height)), (224, 226, 228), frame)
    return picture


def switch(height: int, width: int) -> Texture:
    """A light switch."""
    picture = _sheet(height, width, (232.0, 235.0, 236.0))
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (150, 152, 155), 2)
    cv2.rectangle(picture, (width // 4, height // 5), (3 * width // 4, 4 * height // 5), (195, 198, 200), 2)
    return picture


def radiator(rng: np.random.Generator, height: int, width: int) -> Texture:
    """A ribbed heater."""
    ribs = 14.0 * np.sin(np.arange(width) / max(3.0, width / 60) * 2 * np.pi)
    tone = rng.uniform(205, 222)
    picture = (
        np.broadcast_to((tone + ribs)[None, :, None], (height, width, 3)).clip(0, 255).astype(np.uint8).copy()
    )
    cv2.rectangle(picture, (0, 0), (width - 1, height - 1), (150, 152, 154), max(2, height // 25))
    return picture


def leaf(rng: np.random.Generator, height: int, width: int, tone: float, pane: bool) -> Texture:
    """A door leaf without its frame: wood, a handle, with a ``pane`` or without."""
    picture = wood(rng, height, width, (70 * tone, 105 * tone, 150 * tone))
    if pane:
        box = (int(0.62 * width), int(0.14 * height)), (int(0.82 * width), int(0.5 * height))
        cv2.rectangle(picture, *box, (150, 140, 125), -1)
        cv2.line(picture, box[0], box[1], (185, 178, 168), 2, cv2.LINE_AA)
        cv2.rectangle(picture, *box, (60, 66, 72), 2)
    handle = (int(0.1 * width), int(0.51 * height))
    cv2.rectangle(
        picture,
        (handle[0] - width // 40, handle[1] - width // 12),
        (handle[0] + width // 40, handle[1] + width // 7),
        (196, 202, 206),
        -1,
    )
    cv2.line(
        picture,
        handle,
        (handle[0] + width // 8, handle[1]),
        (165, 172, 178),
        max(3, width // 36),
        cv2.LINE_AA,
    )
    cv2.line(picture, (0, height - height // 12), (width, height - height // 12), (150, 155, 160), 2)
    return picture


__all__ = [
    "arrow",
    "board",
    "direction_sign",
    "exit_sign",
    "landscape",
    "leaf",
    "lettering",
    "notice",
    "numeral",
    "plate",
    "poster",
    "radiator",
    "switch",
    "whiteboard",
    "window",
]
