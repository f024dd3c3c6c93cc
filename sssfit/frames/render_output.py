"""What `sssfit render` writes of a frame: EXR images, pictures of them, and a summary."""

import dataclasses
import io
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sssfit.files.exr import encode_exr
from sssfit.files.json_text import json_text
from sssfit.frames import preview
from sssfit.frames.compare import Comparison
from sssfit.frames.render import Rendered

#: Share of the pixels whose errors lie within the colours of their picture.
_SHOWN = 0.995
#: Pictures with colour bars show every second pixel, every third, ... of frames that are wider.
_WIDEST = 1920
_DPI = 100


def files(
    made: Rendered, error: ArrayLike | None, mask: ArrayLike
) -> tuple[dict[str, bytes], dict[str, float]]:
    """A rendered frame as EXR images and pictures.

    Args:
        made: the frame.
        error: image - reference, (H, W, 3), finite in the mask; None without a reference.
        mask: (H, W), the pixels that have a profile; elsewhere the error is written as 0.

    Returns:
        Files by name: the image, the counts where any were drawn, the error where there is one. And the
        numbers at the ends of the pictures' colours: what is white, the largest count, the error's bounds.

    Example:
        >>> made = Rendered(np.ones((9, 16, 3)), np.full((9, 16), 64), 0, {})
        >>> found, shown = files(made, None, np.ones((9, 16), bool))
        >>> sorted(found), shown
        (['count.exr', 'count.png', 'scattered.exr', 'scattered.png'], {'white': 1.0, 'count': 64.0})
    """
    mask = np.asarray(mask, bool)
    white = float(np.quantile(made.image.max(axis=-1), _SHOWN)) or 1.0
    found = {
        "scattered.exr": _colours("sss", made.image),
        "scattered.png": preview.png(made.image, white=white),
    }
    shown = {"white": white}
    if made.counts.any():
        shown["count"] = float(made.counts.max())
        panel = np.where(made.counts > 0, made.counts.astype(float), np.nan)
        found["count.exr"] = encode_exr({"count": made.counts.astype(np.uint32)}, {})
        found["count.png"] = _picture({"": panel}, "samples", (0.0, shown["count"]), "viridis")
    if error is not None:
        error = np.where(mask[..., None], np.asarray(error, np.float32), np.float32(0))
        shown["error"] = limit = float(np.quantile(np.abs(error[mask]), _SHOWN)) or 1.0
        panels = {n: np.where(mask, error[..., c], np.nan) for c, n in enumerate(("red", "green", "blue"))}
        found["error.exr"] = _colours("error", error)
        found["error.png"] = _picture(panels, "image - reference", (-limit, limit), "RdBu_r")
    return found, shown


def summary(made: Rendered, mask: ArrayLike, comparison: Comparison | None) -> dict[str, Any]:
    """The figures of a rendered frame, with None for what is not known or not finite.

    Args:
        made: the frame.
        mask: (H, W), the pixels that have a profile.
        comparison: with a reference; None without one, and then its figures are None.

    Returns:
        The fields of `compare.Comparison`, the counts of samples and the light left out, for JSON.

    Example:
        >>> made = Rendered(np.zeros((1, 2, 3)), np.array([[64, 0]]), 0, {})
        >>> figures = summary(made, np.array([[True, False]]), None)
        >>> figures["samples"], figures["mean_count"], figures["psnr"]
        (64, 64.0, None)
    """
    names = [field.name for field in dataclasses.fields(Comparison)]
    found = {name: None if comparison is None else getattr(comparison, name) for name in names}
    mask = np.asarray(mask, bool)
    return found | {
        "pixels": int(mask.sum()),
        "samples": int(made.counts.sum(dtype=np.int64)),
        "mean_count": float(made.counts[mask].mean(dtype=np.float64)),
        "pilot_samples": made.pilot_samples,
        "left_out": {str(number): share.tolist() for number, share in made.left_out.items()} or None,
    }


def text(summary: dict[str, Any]) -> bytes:
    """A summary as a JSON file, with null for every number that is NaN or infinite.

    Args:
        summary: nested dicts, lists and tuples.

    Returns:
        UTF-8 text.

    Example:
        >>> text({"psnr": math.inf, "bias": (0.5,)}).split()
        [b'{', b'"bias":', b'[', b'0.5', b'],', b'"psnr":', b'null', b'}']
    """
    return json_text(_finite(summary)).encode()


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _colours(layer: str, image: np.ndarray) -> bytes:
    return encode_exr({f"{layer}.{c}": image[..., i].astype(np.float32) for i, c in enumerate("RGB")}, {})


def _picture(panels: dict[str, np.ndarray], label: str, limits: tuple[float, float], colours: str) -> bytes:
    """Panels by title, side by side with one colour bar; NaN is grey."""
    # Only drawing needs matplotlib; its import costs more than all of sssfit's.
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    height, width = next(iter(panels.values())).shape
    step = math.ceil(width * len(panels) / _WIDEST)
    inches = min(max(width * len(panels) / step / _DPI, 6), 14)
    tall = min(max(inches / len(panels) * height / width, 1.5), 10) + 0.4
    figure = Figure(figsize=(inches + 1, tall), dpi=_DPI, layout="constrained")
    FigureCanvasAgg(figure)
    every = figure.subplots(1, len(panels), squeeze=False)[0]
    colour_map = matplotlib.colormaps[colours].with_extremes(bad="#555555")
    shown = None
    for axes, (title, panel) in zip(every, panels.items(), strict=True):
        part = panel[::step, ::step]
        shown = axes.imshow(part, colour_map, vmin=limits[0], vmax=limits[1], interpolation="nearest")
        axes.set_title(title, fontsize=10)
        axes.set_axis_off()
    assert shown is not None
    figure.colorbar(shown, ax=every.tolist(), label=label, pad=0.01)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", metadata={"Software": None})
    return buffer.getvalue()
