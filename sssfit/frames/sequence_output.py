"""What `sssfit render --mode` writes of a sequence: images and pictures of each frame, and of all of them.

What is written of a frame depends on that frame and those before it, never on later ones.
"""

import io
import math
import os
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sssfit.files.arrays import csv_bytes
from sssfit.files.exr import encode_exr
from sssfit.frames import preview

#: White is this much above the brightest of the first frame with light, for light that grows.
HEADROOM = 2.0
#: Width in pixels above which the moving preview is made smaller, and the milliseconds of one of its frames.
PREVIEW_WIDTH, PREVIEW_MILLISECONDS = 640, 40
#: Share of the pixels that are no brighter than what counts as the brightest.
_SHOWN = 0.995
_BARE = 85
_BLUE, _RED, _GREEN, _GREY = "#2b5fb3", "#c8322d", "#2e8b3d", "#777777"
_DPI = 110


class Row(NamedTuple):
    """Figures of a frame, over its pixels with a profile; None where it has none.

    Attributes:
        frame: its number.
        mean_count: samples drawn in a pixel.
        psnr: against its reference, dB; None without one and for a black frame.
        largest_count: samples.
        share_at_min, share_at_max: of the pixels, those with the smallest and the largest count allowed.
        share_new: of the pixels, those without a history.
        pixels: how many have a profile.
        samples: all that were drawn.
    """

    frame: int
    mean_count: float | None
    psnr: float | None
    largest_count: int | None
    share_at_min: float | None
    share_at_max: float | None
    share_new: float | None
    pixels: int
    samples: int


def row(
    frame: int,
    counts: ArrayLike,
    missing: ArrayLike,
    mask: ArrayLike,
    bounds: tuple[int, int],
    psnr: float | None = None,
) -> Row:
    """The figures of a frame.

    Args:
        frame: its number.
        counts: samples drawn in each pixel, (H, W).
        missing: where there was no history, boolean, (H, W).
        mask: the pixels with a profile, boolean, (H, W).
        bounds: the smallest and the largest count allowed.
        psnr: against its reference, dB.

    Returns:
        See `Row`.

    Example:
        >>> found = row(3, [[8, 64, 0]], [[True, True, True]], [[True, True, False]], (8, 64))
        >>> found.mean_count, found.share_at_max, found.share_new, found.pixels
        (36.0, 0.5, 1.0, 2)
    """
    mask = np.asarray(mask, bool)
    drawn, new = np.asarray(counts)[mask], np.asarray(missing, bool)[mask]
    if not len(drawn):
        return Row(frame, None, None, None, None, None, None, 0, 0)
    samples = int(drawn.sum(dtype=np.int64))
    return Row(
        frame,
        mean_count=samples / len(drawn),
        psnr=psnr,
        largest_count=int(drawn.max()),
        share_at_min=float(np.mean(drawn == bounds[0])),
        share_at_max=float(np.mean(drawn == bounds[1])),
        share_new=float(new.mean()),
        pixels=len(drawn),
        samples=samples,
    )


def white(image: ArrayLike) -> float | None:
    """What the pictures of a sequence shall show as white, from its first frame with light.

    Args:
        image: (H, W, 3), linear.

    Returns:
        `HEADROOM` times the 99.5 % quantile of the largest channel; None where that is 0.

    Example:
        >>> white(np.ones((9, 16, 3))), white(np.zeros((9, 16, 3)))
        (2.0, None)
    """
    brightest = float(np.quantile(np.asarray(image).max(axis=-1), _SHOWN))
    return HEADROOM * brightest if brightest > 0 else None


def files(image: ArrayLike, counts: ArrayLike, digits: str, *, white: float, most: int) -> dict[str, bytes]:
    """A frame as EXR images and pictures.

    Args:
        image: (H, W, 3), linear.
        counts: samples drawn in each pixel, (H, W).
        digits: the frame's number as its name has it.
        white: what is shown as white.
        most: the count that is shown brightest; 0 is darkest, and grey where none were drawn.

    Returns:
        Files by name; the same frame gives the same bytes.

    Example:
        >>> sorted(files(np.ones((9, 16, 3)), np.full((9, 16), 8), "07", white=1.0, most=64))
        ['count_07.exr', 'count_07.png', 'scattered_07.exr', 'scattered_07.png']
    """
    image, counts = np.asarray(image, np.float32), np.asarray(counts).astype(np.uint32)
    return {
        f"scattered_{digits}.exr": encode_exr({f"sss.{c}": image[..., i] for i, c in enumerate("RGB")}, {}),
        f"scattered_{digits}.png": preview.png(image, white=white),
        f"count_{digits}.exr": encode_exr({"count": counts}, {}),
        f"count_{digits}.png": _count_picture(counts, most),
    }


def names(every_digits: Sequence[str]) -> list[str]:
    """All files that a sequence writes.

    Args:
        every_digits: the frames' numbers as their names have them.

    Returns:
        Their names in the output directory.

    Example:
        >>> names(["07"])[:2]
        ['scattered_07.exr', 'scattered_07.png']
    """
    kinds = ("scattered_{}.exr", "scattered_{}.png", "count_{}.exr", "count_{}.png")
    of_all = ("csv", "png", "webp")
    found = [kind.format(digits) for digits in every_digits for kind in kinds]
    found += [f"sequence.{kind}" for kind in of_all]
    return [*found, "summary.json", "manifest.json", "timing.csv"]


def table(rows: Sequence[Row]) -> bytes:
    """The figures of all frames.

    Args:
        rows: in the frames' order.

    Returns:
        A CSV file with the fields of `Row` as columns, empty where there is nothing.

    Example:
        >>> table([Row(0, None, None, None, None, None, None, 0, 0)]).splitlines()[1]
        b'0,,,,,,,0,0'
    """
    return csv_bytes({name: _column([getattr(r, name) for r in rows]) for name in Row._fields})


def timing(rows: Sequence[Row], seconds: Sequence[tuple[float, float, float]]) -> bytes:
    """The times of all frames.

    Args:
        rows: in the frames' order.
        seconds: of each: waiting for its file, its step, writing.

    Returns:
        A CSV file.

    Example:
        >>> timing([Row(0, 8.0, None, 8, 1.0, 0.0, 1.0, 1, 8)], [(0.1, 1.0, 0.2)]).splitlines()[0]
        b'frame,reading_seconds,step_seconds,writing_seconds'
    """
    columns = dict(zip(("reading", "step", "writing"), zip(*seconds, strict=True), strict=True))
    return csv_bytes({"frame": [r.frame for r in rows]} | {f"{n}_seconds": v for n, v in columns.items()})


def summary(rows: Sequence[Row]) -> dict[str, Any]:
    """The figures of a sequence.

    Args:
        rows: in the frames' order, at least one.

    Returns:
        How many frames, the first and the last number, means of the frames' counts and PSNR (of those that
        have a finite one, `psnr_frames`), and all samples, for JSON.

    Example:
        >>> rows = [Row(k, 8.0 + k, 40.0 if k else None, 8, 1.0, 0.0, 0.0, 10, 80) for k in range(2)]
        >>> found = summary(rows)
        >>> found["mean_count"], found["psnr"], found["psnr_frames"], found["samples"]
        (8.5, 40.0, 1, 160)
    """
    counts = [r.mean_count for r in rows if r.mean_count is not None]
    psnr = [r.psnr for r in rows if r.psnr is not None and math.isfinite(r.psnr)]
    return {
        "frames": len(rows),
        "first_frame": rows[0].frame,
        "last_frame": rows[-1].frame,
        "mean_count": math.fsum(counts) / len(counts) if counts else None,
        "psnr": math.fsum(psnr) / len(psnr) if psnr else None,
        "psnr_frames": len(psnr),
        "samples": sum(r.samples for r in rows),
    }


def plot(rows: Sequence[Row], *, title: str, bounds: tuple[int, int]) -> bytes:
    """Counts over time, shares of the pixels, and the PSNR where there is one.

    Args:
        rows: in the frames' order.
        title: of the picture.
        bounds: the smallest and the largest count allowed.

    Returns:
        A PNG file; the same figures give the same bytes.

    Example:
        >>> rows = [Row(k, 8.0 + k, 40.0, 64, 0.5, 0.1, 0.0, 10, 80) for k in range(4)]
        >>> plot(rows, title="ocv", bounds=(8, 64))[1:4]
        b'PNG'
    """
    # Only drawing needs matplotlib; its import costs more than all of sssfit's.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    numbers = np.array([r.frame for r in rows])
    found = {name: _floats([getattr(r, name) for r in rows]) for name in Row._fields}
    compared = np.isfinite(found["psnr"])
    panels = 3 if compared.any() else 2
    figure = Figure(figsize=(9, 1.2 + 2.2 * panels), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    every = figure.subplots(panels, 1, sharex=True)
    for bound in dict.fromkeys(bounds):
        every[0].axhline(bound, color=_GREY, ls=":", lw=1)
    every[0].plot(numbers, found["mean_count"], color=_BLUE, lw=1.6, marker=".", label="mean over the pixels")
    every[0].plot(numbers, found["largest_count"], color=_GREY, lw=1, label="largest")
    every[0].set(ylabel="samples per pixel", ylim=(0, 1.08 * bounds[1]))
    shares = {
        "share_at_min": (_GREEN, f"with {bounds[0]} samples"),
        "share_at_max": (_RED, f"with {bounds[1]}"),
        "share_new": (_GREY, "without a history"),
    }
    for name, (colour, label) in shares.items():
        every[1].plot(numbers, 100 * found[name], color=colour, lw=1.3, marker=".", ms=4, label=label)
    every[1].set(ylabel="share of the pixels [%]", ylim=(-3, 103))
    if compared.any():
        every[2].plot(numbers[compared], found["psnr"][compared], color=_BLUE, lw=1, marker="o", ms=4)
        every[2].set(ylabel="PSNR [dB]")
    for axes in every:
        axes.grid(alpha=0.3)
        axes.set_axisbelow(True)
    for axes in every[:2]:
        axes.legend(frameon=False, fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5))
    every[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    every[-1].set(xlabel="frame")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()


def moving_preview(pictures: Sequence[str | os.PathLike[str]]) -> bytes:
    """The frames as a moving picture.

    Args:
        pictures: PNG files of one size, in order; wide ones are made smaller.

    Returns:
        An animated WebP file; the same pictures give the same bytes.

    Example:
        >>> import pathlib, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     path = pathlib.Path(folder) / "one.png"
        ...     _ = path.write_bytes(preview.png(np.ones((9, 16, 3))))
        ...     moving_preview([path, path])[8:12]
        b'WEBP'
    """
    from PIL import Image

    made = []
    for path in pictures:
        with Image.open(path) as picture:
            made.append(picture.convert("RGB").reduce(math.ceil(picture.width / PREVIEW_WIDTH)))
    stream = io.BytesIO()
    options = {"save_all": True, "append_images": made[1:], "duration": PREVIEW_MILLISECONDS, "loop": 0}
    made[0].save(stream, "webp", **options, quality=85, method=4)
    return stream.getvalue()


def _count_picture(counts: np.ndarray, most: int) -> bytes:
    """Counts in colours, without a bar beside them, which would take most of a small frame's time."""
    import matplotlib
    from PIL import Image

    colours = (255 * matplotlib.colormaps["viridis"](np.linspace(0, 1, 256))[:, :3]).round().astype(np.uint8)
    shown = colours[np.clip(np.round(counts * (255 / most)), 0, 255).astype(np.uint8)]
    stream = io.BytesIO()
    Image.fromarray(np.where((counts > 0)[..., None], shown, np.uint8(_BARE))).save(stream, "png")
    return stream.getvalue()


def _column(values: list) -> np.ndarray:
    """Numbers, and nothing where there are none."""
    column = np.empty(len(values), object)
    column[:] = values
    return column


def _floats(values: list) -> np.ndarray:
    return np.array([math.nan if value is None else value for value in values], float)
