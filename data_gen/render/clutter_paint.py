"""How each thing on a table or wall is painted: flat, the square root of reflectance in 8 bit, then coverage."""

from __future__ import annotations

import cv2
import numpy as np

from hybrid.coords import linear_from_srgb

MUTED = 0.6
"""Factor on how far things' colours lie from grey, in powers of two: printed and dyed things are mostly muted."""

Rectangle = tuple[float | int, float | int, float | int, float | int]
"""x0, y0, x1, y1 in shares of a picture's sides."""


def _code(reflectance: np.ndarray | float) -> tuple[int, int, int]:
    red, green, blue = (int(255 * np.sqrt(c)) for c in np.clip(np.broadcast_to(reflectance, 3), 0.003, 0.9))
    return red, green, blue


def _any(rng: np.random.Generator, strength: float = 0.7) -> tuple[int, int, int]:
    """A random colour."""
    return _code(10 ** rng.uniform(-1.3, -0.2) * np.exp2(rng.normal(0, MUTED * strength, 3)))


def _fill(picture: np.ndarray, box: Rectangle, code: tuple[int, int, int]) -> None:
    """Paints a rectangle x0, y0, x1, y1 given in shares of the picture's sides."""
    h, w = picture.shape[:2]
    x0, y0, x1, y1 = box
    picture[
        round(y0 * h) : max(round(y1 * h), round(y0 * h) + 1), round(x0 * w) : max(round(x1 * w), round(x0 * w) + 1), :3
    ] = code


def _text(picture: np.ndarray, box: Rectangle, lines: int, rng: np.random.Generator) -> None:
    """Lines of words: dark dashes of random length, the last of a paragraph shorter."""
    x0, y0, x1, y1 = box
    ink = _code(rng.uniform(0.01, 0.12))
    for k in range(lines):
        y = y0 + (y1 - y0) * k / lines
        stop = x0 + (x1 - x0) * (rng.uniform(0.2, 0.8) if rng.random() < 0.2 else 1.0)
        x = x0
        while x < stop:
            step = rng.uniform(0.02, 0.09)
            _fill(picture, (x, y, min(x + step, stop), y + 0.45 * (y1 - y0) / lines), ink)
            x += step + 0.012


def _paper(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A typed page: letterhead, paragraphs, a table or a picture."""
    picture[..., :3] = _code(np.array([0.8, 0.79, 0.76]) * rng.uniform(0.8, 1.05))
    _fill(picture, (0.1, 0.06, rng.uniform(0.3, 0.6), 0.09), _code(rng.uniform(0.02, 0.2)))
    if rng.random() < 0.4:
        _fill(picture, (0.72, 0.05, 0.9, 0.11), _any(rng, 1.2))
    top = 0.16
    while top < 0.8:
        high = rng.uniform(0.1, 0.25)
        kind = rng.random()
        if kind < 0.15:
            _fill(picture, (0.1, top, rng.uniform(0.4, 0.9), min(top + high, 0.92)), _any(rng))
        elif kind < 0.4:
            for x in np.linspace(0.1, 0.9, 5):
                _fill(picture, (x, top, x + 0.004, top + high), _code(0.15))
            _text(picture, (0.12, top, 0.88, top + high), int(high * 40), rng)
        else:
            _text(picture, (0.1, top, 0.9, top + high), int(high * 55), rng)
        top += high + 0.03


def _book(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A cover with title and a panel; the spine along its left side."""
    picture[..., :3] = _any(rng, 1.0)
    if rng.random() < 0.6:
        _fill(picture, (0.12, rng.uniform(0.3, 0.5), 0.92, rng.uniform(0.6, 0.95)), _any(rng, 1.0))
    _text(picture, (0.15, 0.1, 0.85, 0.28), 2, rng)
    picture[:, : max(3, picture.shape[1] // 20), :3] //= 2


def _keyboard(picture: np.ndarray, rng: np.random.Generator) -> None:
    """Rows of keys with rounded looks, dark or light."""
    dark = rng.random() < 0.6
    picture[..., :3] = _code(0.02 if dark else 0.5)
    key, letter = _code(0.045 if dark else 0.7), _code(0.5 if dark else 0.1)
    for row in range(5):
        shift = 0.012 * row
        for k in range(18):
            x0, y0 = 0.02 + shift * (k < 14) + 0.053 * k, 0.06 + 0.18 * row
            if row == 4 and 4 <= k <= 8:
                _fill(picture, (x0, y0, x0 + 0.055, y0 + 0.15), key)
                continue
            _fill(picture, (x0, y0, x0 + 0.045, y0 + 0.15), key)
            _fill(picture, (x0 + 0.012, y0 + 0.03, x0 + 0.022, y0 + 0.07), letter)


def _cup(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A mug from above: rim, inside getting darker, drink, handle."""
    h, w = picture.shape[:2]
    picture[..., 3] = 0
    centre, radius = (h // 2, h // 2), h // 2 - 2
    wall = _any(rng, 0.5)
    cv2.ellipse(
        picture, (h, h // 2), (max(w - h - 3, 8), h // 5), 0, 0, 360, (*wall, 255), max(4, h // 12), cv2.LINE_AA
    )
    cv2.circle(picture, centre, radius, (*wall, 255), -1, cv2.LINE_AA)
    cv2.circle(picture, centre, int(0.88 * radius), (*(c // 2 for c in wall), 255), -1, cv2.LINE_AA)
    cv2.circle(
        picture,
        (centre[0] + 2, centre[1] + 2),
        int(0.82 * radius),
        (*_code(np.array([0.05, 0.02, 0.008])), 255),
        -1,
        cv2.LINE_AA,
    )


def _pen(picture: np.ndarray, rng: np.random.Generator) -> None:
    """Barrel with a highlight along it, cap and tip."""
    across = 1 - np.linspace(-0.9, 0.6, len(picture)) ** 2
    code = np.array(_any(rng, 1.2))
    picture[..., :3] = (np.clip(across, 0.25, 1)[:, None, None] * code).astype(np.uint8)
    _fill(picture, (0.0, 0, 0.25, 1), _any(rng, 0.5))
    _fill(picture, (0.96, 0, 1.0, 0.3), _code(0.3))
    picture[: len(picture) // 4, int(0.95 * picture.shape[1]) :, 3] = 0
    picture[-(len(picture) // 4) :, int(0.95 * picture.shape[1]) :, 3] = 0


def _cable(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A smooth loop of cable."""
    h, w = picture.shape[:2]
    t = np.linspace(0, 1, 60)
    x = w * (0.05 + 0.9 * t + 0.08 * np.sin(2 * np.pi * (t * rng.uniform(0.5, 2) + rng.random())) * t * (1 - t) * 4)
    y = h * (0.5 + 0.4 * np.sin(2 * np.pi * (t * rng.uniform(0.4, 1.2) + rng.random())))
    points = np.stack([x, y], axis=-1).round().astype(np.int32)
    picture[..., 3] = 0
    code = _code(0.02) if rng.random() < 0.6 else _code(0.6)
    picture[..., :3] = code
    cv2.polylines(picture, [points], False, (*code, 255), int(rng.integers(4, 8)), cv2.LINE_AA)
    lit = tuple(min(255, c + 40) for c in code)
    cv2.polylines(picture, [points - 1], False, (*lit, 255), 1, cv2.LINE_AA)


def _film(picture: np.ndarray, rng: np.random.Generator) -> None:
    """Another film: dark, with rows of cut bodies or heads; or one large projection."""
    h, w = picture.shape[:2]
    picture[..., :3] = _code(np.array([0.9, 1.0, 1.1]) * 10 ** rng.uniform(-2.2, -1.5))
    rows, cols = int(rng.integers(1, 7)), int(rng.integers(1, 6))
    bone, inside = rng.uniform(0.3, 0.8), rng.uniform(0.05, 0.3)
    aspect = rng.uniform(0.7, 1.3)
    for r in range(rows):
        for c in range(cols):
            centre = (int((c + rng.normal(1, 0.02) / 2) * w / cols), int((r + rng.normal(1, 0.02) / 2) * h / rows))
            half = 0.4 * min(w / cols / aspect, h / rows) * rng.uniform(0.8, 1.0)
            axes = (max(2, int(half * aspect)), max(2, int(half)))
            cv2.ellipse(picture, centre, axes, 0, 0, 360, (*_code(bone), 255), -1, cv2.LINE_AA)
            core = (int(0.86 * axes[0]), int(0.86 * axes[1]))
            cv2.ellipse(picture, centre, core, 0, 0, 360, (*_code(inside), 255), -1, cv2.LINE_AA)
            for _ in range(6):
                spot = tuple(int(p + rng.normal(0, 0.35) * a) for p, a in zip(centre, core, strict=True))
                small = (max(1, int(core[0] * rng.uniform(0.08, 0.3))), max(1, int(core[1] * rng.uniform(0.08, 0.3))))
                code = (*_code(inside * rng.uniform(0.2, 2.2)), 255)
                cv2.ellipse(picture, spot, small, rng.uniform(0, 180), 0, 360, code, -1, cv2.LINE_AA)


def _folder(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A card folder with a label and a tab."""
    colours = [[0.85, 0.74, 0.5], [0.35, 0.5, 0.7], [0.75, 0.4, 0.35], [0.5, 0.65, 0.5]]
    picture[..., :3] = _code(linear_from_srgb(np.array(colours[rng.integers(4)])))
    _fill(picture, (0.2, 0.15, 0.8, 0.3), _code(0.75))
    _text(picture, (0.24, 0.17, 0.76, 0.28), 3, rng)
    _fill(picture, (0, 0.985, 1, 1.0), _code(0.1))


def _phone(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A phone, screen dark."""
    picture[..., :3] = _code(rng.uniform(0.01, 0.3))
    _fill(picture, (0.04, 0.02, 0.96, 0.98), _code(rng.uniform(0.006, 0.02)))


def _poster(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A framed print: fields of colour and a heading."""
    picture[..., :3] = _code(rng.uniform(0.02, 0.5))
    _fill(picture, (0.03, 0.02, 0.97, 0.98), _any(rng, 0.4))
    for _ in range(int(rng.integers(2, 6))):
        x, y = rng.uniform(0.06, 0.7, 2)
        _fill(picture, (x, y, x + rng.uniform(0.08, 0.25), y + rng.uniform(0.05, 0.25)), _any(rng, 1.0))
    _text(picture, (0.1, 0.05, 0.9, 0.14), 2, rng)


def _socket(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A double socket or a switch in a white frame."""
    h, w = picture.shape[:2]
    picture[..., :3] = _code(np.array([0.75, 0.74, 0.7]))
    for x in (0.27, 0.73):
        if rng.random() < 0.6:
            cv2.circle(picture, (int(x * w), h // 2), h // 4, (*_code(0.55), 255), -1, cv2.LINE_AA)
            for shift in (-h // 10, h // 10):
                cv2.circle(picture, (int(x * w) + shift, h // 2), 3, (*_code(0.02), 255), -1, cv2.LINE_AA)
        else:
            _fill(picture, (x - 0.16, 0.2, x + 0.16, 0.8), _code(0.68))
            _fill(picture, (x - 0.16, 0.5, x + 0.16, 0.51), _code(0.3))


def _screen(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A monitor that is on: windows, text, sometimes CT."""
    picture[..., :3] = _code(0.01)
    _fill(picture, (0.02, 0.03, 0.98, 0.94), _any(rng, 0.6))
    for _ in range(int(rng.integers(1, 4))):
        x, y = rng.uniform(0.04, 0.45), rng.uniform(0.06, 0.4)
        box = (x, y, x + rng.uniform(0.3, 0.5), y + rng.uniform(0.3, 0.5))
        _fill(picture, box, _code(0.85 if rng.random() < 0.6 else 0.02))
        _text(picture, (box[0] + 0.02, box[1] + 0.04, box[2] - 0.02, box[3] - 0.02), 12, rng)


def _shelf(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A board with book spines on it."""
    picture[..., 3] = 0
    x = 0.02
    while x < 0.95:
        wide, high = rng.uniform(0.015, 0.06), rng.uniform(0.55, 0.9)
        box = (x, 0.93 - high, min(x + wide, 0.98), 0.93)
        if rng.random() < 0.85:
            _fill(picture, box, _any(rng, 0.9))
            h, w = picture.shape[:2]
            picture[round(box[1] * h) : round(0.93 * h), round(box[0] * w) : round(box[2] * w), 3] = 255
        x += wide
    _fill(picture, (0, 0.93, 1, 1), _any(rng, 0.3))
    picture[round(0.93 * len(picture)) :, :, 3] = 255


def _window(picture: np.ndarray, rng: np.random.Generator) -> None:
    """Panes of daylight in a white frame."""
    picture[..., :3] = _code(0.85)
    sky = np.linspace(1, 0.5, len(picture))[:, None, None] * np.array(_code(np.array([0.75, 0.85, 0.9])))
    picture[..., :3] = sky.astype(np.uint8)
    frame = _code(0.12)
    for edge in (0.0, rng.uniform(0.45, 0.55), 0.95):
        _fill(picture, (edge, 0, edge + 0.05, 1), frame)
        _fill(picture, (0, edge, 1, edge + 0.04), frame)


def _rail(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A wall rail or cable duct: light edge above, shadow below."""
    code = np.array(_any(rng, 0.2), np.float64)
    profile = np.interp(np.linspace(0, 1, len(picture)), [0, 0.08, 0.3, 0.85, 1], [1.2, 1.0, 0.95, 0.85, 0.5])
    picture[..., :3] = np.clip(profile[:, None, None] * code, 0, 255).astype(np.uint8)


def _scrap(picture: np.ndarray, rng: np.random.Generator) -> None:
    """A sticky note."""
    colours = [[0.97, 0.9, 0.45], [0.95, 0.6, 0.7], [0.6, 0.85, 0.95], [0.95, 0.95, 0.93]]
    picture[..., :3] = _code(linear_from_srgb(np.array(colours[rng.integers(4)])))
    _text(picture, (0.1, 0.15, 0.9, 0.7), int(rng.integers(2, 5)), rng)


PAINTED = {
    "paper": _paper,
    "book": _book,
    "keyboard": _keyboard,
    "cup": _cup,
    "pen": _pen,
    "cable": _cable,
    "film": _film,
    "folder": _folder,
    "phone": _phone,
    "poster": _poster,
    "socket": _socket,
    "screen": _screen,
    "shelf": _shelf,
    "window": _window,
    "rail": _rail,
    "scrap": _scrap,
}
