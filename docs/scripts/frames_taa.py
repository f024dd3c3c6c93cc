"""What a viewer sees of the noisy images: the average over frames, with and without clamping."""

import io
from collections.abc import Iterator
from typing import Any

import equinox as eqx
import matplotlib.pyplot as plt
import numpy as np
from frames_data import save, table, three, write
from frames_moving import TARGET, Film, flashing, head, turning
from frames_sequences import BOUNDS, FIRST, LIT, PAGE, many_samples, policy
from scipy import ndimage

from sssfit.estimators import policies
from sssfit.frames import compare, preview, scatter, sequence, taa
from sssfit.frames.gbuffer import Frame
from sssfit.frames.points import Settings

accumulate = eqx.filter_jit(taa.accumulate)

#: Frames of the still head, and how many of them, the last, are measured.
STILL_FRAMES, LAST = 48, 16
#: The light's period in frames, and the frames of whole periods that its swing is measured over.
PERIOD, WHOLE = 12, slice(12, 48)
OPTIONS = ("noisy", *taa.CLAMPINGS)
#: Of the sheet: frames, what they show, the middle of the crop; its size and how many times it is enlarged.
SHEET = (
    (14, "nose, eye", (196, 128)), (19, "ear, light falls", (312, 142)), (27, "mouth", (182, 190)),
    (38, "temple", (292, 62)), (41, "ear, light falls", (300, 142)),
)  # fmt: skip
CROP, LARGER = 72, 3
#: Of the streaks: the frame, the pixels, what they are smoothed by, samples.
STREAKS, TEMPLE, SMOOTH, MANY = 39, (slice(40, 75), slice(245, 285)), 4, 4096


def chosen_policies() -> dict[str, Any]:
    found = {f"fixed {spp}": policies.named("fixed", spp=spp) for spp in BOUNDS}
    return {name: policy(name, TARGET) for name in ("as", "in_frame")} | found


def watched(
    of: Film, chosen: Any, settings: Settings = scatter.DEFAULT
) -> Iterator[tuple[int, dict[str, np.ndarray], np.ndarray]]:
    """Of each frame its number, the noisy image and its average over frames by each option, and counts."""
    seen: dict[str, Any] = {}
    config = sequence.Config(chosen, of.profiles, settings)
    for state, image, info in sequence.scan(of.frames, config):
        k = state.number - 1
        given = {
            "motion": of.frames[k].motion,
            "missing": info.missing,
            "mask": of.masks[k],
            "previous_mask": of.masks[max(k - 1, 0)],
        }
        for clamping in taa.CLAMPINGS:
            config = taa.Config(clamping=clamping)
            seen[clamping] = accumulate(seen.get(clamping, image), image, **given, config=config)
        shown = {"noisy": image} | seen
        yield k, {name: np.asarray(v, float) for name, v in shown.items()}, np.asarray(info.counts)


def bright(image: np.ndarray) -> np.ndarray:
    return np.asarray(sequence.luminance(image), float)


# --- under a light that flashes


def study_taa() -> None:
    of, rows = flashing(), []
    for name, chosen in chosen_policies().items():
        rows += flash_rows(of, name, chosen)
    write("taa", table(rows, 2), PAGE)
    draw_sheet(of)
    rows, turns = [], turning()
    for name, chosen in chosen_policies().items():
        rows += turning_rows(turns, name, chosen)
    write("taa turning", table(rows, 2), PAGE)
    rows = []
    still = still_head()
    for name, chosen in chosen_policies().items():
        rows += still_rows(still, name, chosen, scatter.DEFAULT)
        if name.startswith("fixed"):
            rows += still_rows(still, f"{name}, fresh points", chosen, Settings(points="fresh"))
    write("taa still", table(rows, 2), PAGE)
    write("streaks", table(streak_rows(of.frames[STREAKS], of.profiles)), PAGE)


def flash_rows(of: Film, name: str, chosen: Any) -> list[dict[str, str]]:
    psnr: dict[str, list[float]] = {option: [] for option in OPTIONS}
    light = {option: np.zeros(len(of.frames)) for option in (*OPTIONS, "exact")}
    drawn = []
    for k, shown, counts in watched(of, chosen):
        mask, many = of.masks[k], of.many[k]
        for option, image in shown.items():
            light[option][k] = bright(image)[mask].mean()
            if k >= FIRST and many[0][mask].max() > LIT * of.brightest:
                psnr[option].append(compare.compare(image, *many, mask).psnr)
        light["exact"][k] = bright(many[0])[mask].mean()
        if k >= FIRST:
            drawn.append(counts[mask].mean())
    exact = light["exact"][WHOLE]
    wave = np.exp(-2j * np.pi * np.arange(len(exact)) / PERIOD)
    rows = []
    for option in OPTIONS:
        off = light[option][WHOLE] - exact
        swing = (light[option][WHOLE] @ wave) / (exact @ wave)
        rows.append(
            {
                "policy": name,
                "shown": option,
                "mean count": f"{np.mean(drawn):.1f}",
                "PSNR, dB": f"{np.mean(psnr[option]):.2f}",
                "worst frame, dB": f"{np.min(psnr[option]):.2f}",
                "error of the mean light, %": f"{100 * np.sqrt(np.mean(off**2)) / exact.mean():.2f}",
                "its mean, %": f"{100 * off.mean() / exact.mean():+.2f}",
                "swing kept": f"{abs(swing):.3f}",
                "late by, frames": f"{-np.angle(swing) * PERIOD / (2 * np.pi):.2f}",
            }
        )
        print(rows[-1], flush=True)
    return rows


# --- a head that turns under constant light


def turning_rows(of: Film, name: str, chosen: Any) -> list[dict[str, str]]:
    """PSNR, and how much of the light there is, on all of the head and in its shadows, which get none."""
    psnr: dict[str, list[float]] = {option: [] for option in OPTIONS}
    light: dict[str, list[np.ndarray]] = {option: [] for option in (*OPTIONS, "exact")}
    for k, shown, _ in watched(of, chosen):
        if k < len(of.frames) - LAST:
            continue
        mask, many = of.masks[k], of.many[k]
        shadow = mask & (np.asarray(of.frames[k].irradiance).max(axis=-1) == 0)
        for option, image in (shown | {"exact": many[0]}).items():
            light[option].append(np.array([image[mask].mean(axis=0), image[shadow].mean(axis=0)]))
            if option != "exact":
                psnr[option].append(compare.compare(image, *many, mask).psnr)
    rows = []
    for option in OPTIONS:
        everywhere, shadow = np.mean(light[option], axis=0) / np.mean(light["exact"], axis=0)
        rows.append(
            {
                "policy": name,
                "shown": option,
                "PSNR, dB": f"{np.mean(psnr[option]):.2f}",
                "light kept (red, green, blue)": three(everywhere, ".3f"),
                "in the shadows": three(shadow, ".2f"),
            }
        )
        print(rows[-1], flush=True)
    return rows


# --- a still head


def still_head() -> Film:
    frame, profiles = head()
    mask, many = np.asarray(frame.profile_id) == 1, many_samples(frame, profiles)
    return Film([frame] * STILL_FRAMES, profiles, [mask] * STILL_FRAMES, [many] * STILL_FRAMES)


def still_rows(
    of: Film, name: str, chosen: Any, settings: Settings = scatter.DEFAULT
) -> list[dict[str, str]]:
    """Light in parts of its mean over the head."""
    psnr: dict[str, list[float]] = {option: [] for option in OPTIONS}
    values: dict[str, list[np.ndarray]] = {option: [] for option in OPTIONS}
    drawn, mask, many = [], of.masks[0], of.many[0]
    for k, shown, counts in watched(of, chosen, settings):
        if k < STILL_FRAMES - LAST:
            continue
        drawn.append(counts[mask].mean())
        for option, image in shown.items():
            psnr[option].append(compare.compare(image, *many, mask).psnr)
            values[option].append(bright(image)[mask])
    exact, rows = bright(many[0])[mask].mean(), []
    for option in OPTIONS:
        found = np.array(values[option]) / exact
        flicker = found.std(axis=0, ddof=1)
        rows.append(
            {
                "policy": name,
                "shown": option,
                "mean count": f"{np.mean(drawn):.1f}",
                "PSNR, dB": f"{np.mean(psnr[option]):.2f}",
                "bias of the mean, %": f"{100 * (found.mean() - 1):+.2f}",
                "flicker of a pixel, %": f"{100 * flicker.mean():.2f}",
                "99th percentile, %": f"{100 * np.quantile(flicker, 0.99):.2f}",
                "of the whole head, %": f"{100 * found.mean(axis=1).std(ddof=1):.3f}",
            }
        )
        print(rows[-1], flush=True)
    return rows


# --- streaks that many samples show too


def streak_rows(frame: Frame, profiles: dict[int, Any]) -> list[dict[str, str]]:
    """What is left of an even light's image when its mean over some pixels around is taken off."""
    mask = np.asarray(frame.profile_id) == 1
    even = frame._replace(irradiance=np.repeat(mask[..., None], 3, axis=-1).astype(np.float32))
    rows = []
    for title, normal in {"as given": frame.normal, "of the depth": normals_of(frame)}.items():
        seen = even._replace(normal=np.asarray(normal, np.float32))
        found = np.asarray(scatter.every_profile(seen, profiles, counts=MANY, seed=3), float)
        rest = (found - ndimage.gaussian_filter(found, (SMOOTH, SMOOTH, 0)))[TEMPLE]
        cells = 100 * rest.std(axis=(0, 1)) / found[TEMPLE].mean(axis=(0, 1))
        rows.append({"normals": title, "streaks, % (red, green, blue)": three(cells)})
    return rows


def normals_of(frame: Frame) -> np.ndarray:
    """Across the surface through the pixels beside each; those given, at the edges of the frame."""
    column, row = frame.camera.pixel_centres()
    place = np.asarray(frame.camera.position(column, row, frame.depth), float)
    found = np.array(frame.normal, float)
    across, up = place[1:-1, 2:] - place[1:-1, :-2], place[:-2, 1:-1] - place[2:, 1:-1]
    normal = np.cross(across, up)
    found[1:-1, 1:-1] = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
    return found


# --- a sheet of crops


def draw_sheet(of: Film) -> None:
    """One white for all, so that what lags behind the light is seen to."""
    crops = {}
    for k, shown, _ in watched(of, policy("in_frame", TARGET)):
        for column, (frame, _, middle) in enumerate(SHEET):
            if frame == k:
                shown["many samples"] = of.many[k][0]
                for row, image in shown.items():
                    crops[row, column] = crop(np.where(of.masks[k][..., None], image, 0), middle)
    rows = (*OPTIONS, "many samples")
    side, gap, left, top = CROP * LARGER, 4, 112, 24
    width, height = left + len(SHEET) * (side + gap), top + len(rows) * (side + gap)
    figure = plt.figure(figsize=(width / 100, height / 100), dpi=100)
    for (row, column), image in crops.items():
        x, y = left + column * (side + gap), top + rows.index(row) * (side + gap)
        axes = figure.add_axes((x / width, 1 - (y + side) / height, side / width, side / height))
        axes.imshow(plt.imread(io.BytesIO(preview.png(image, white=of.brightest))), interpolation="nearest")
        axes.set_axis_off()
        if row == rows[0]:
            axes.set_title(f"frame {SHEET[column][0]}: {SHEET[column][1]}", fontsize=9, pad=3)
        if column == 0:
            figure.text(4 / width, 1 - (y + side / 2) / height, row, fontsize=9, va="center")
    save(figure, "taa")


def crop(image: np.ndarray, middle: tuple[int, int]) -> np.ndarray:
    x, y = (m - CROP // 2 for m in middle)
    return image[y : y + CROP, x : x + CROP]


STUDIES = {"taa": study_taa}
