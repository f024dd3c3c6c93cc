"""What `sssfit trade` found on one machine, for the page of it; and whether a second run agrees.

    python docs/scripts/trade.py RUN LOOK SECOND_LOOK ON_FRAME ...

RUN is a directory of `sssfit trade`, LOOK and SECOND_LOOK are two of `--quick`, the others those of `--only
cost_model scene_needs --frame ...`, named as the scenes. Pictures of RUN go into docs/images, tables into
docs/trade.md.
"""

import json
import shutil
import sys
from pathlib import Path
from typing import Any

import frames_data
import numpy as np
import page

PAGE = frames_data.DOCS / "trade.md"
#: Pictures that the page shows.
SHOWN = ("inverse_cdfs", "estimators", "cost_model", "scene_needs")


def load(folder: str) -> dict[str, Any]:
    return json.loads((Path(folder) / "trade.json").read_text())


def rows(found: dict[str, Any]) -> dict[tuple[str, str], dict[str, Any]]:
    """Choices by the names of group and choice."""
    return {
        (one["group"], one["choice"]): one for group in found["groups"].values() for one in group["choices"]
    }


def overview(found: dict[str, Any]) -> str:
    """The default of each group, if it has one, beside the choices on its front."""
    lines = []
    for name, group in found["groups"].items():
        best = [one["choice"] for one in group["choices"] if not one["beaten_by"]]
        default = next((one for one in group["choices"] if one["is_default"]), None)
        lines.append(
            {
                "group": f"`{name}`",
                "default": default["choice"] if default else "",
                "beaten by": default["beaten_by"] if default else "",
                "on the front": "; ".join(best),
                "choices": str(len(group["choices"])),
                "the default's error": f"{default['error']:.2g}" if default else "",
                "its cost": cost(default, group) if default else "",
            }
        )
    return frames_data.table(lines, 4)


def cost(one: dict[str, Any], group: dict[str, Any]) -> str:
    """What a unit of work costs."""
    if group["cost"] == "samples":
        return f"{one['samples']:.3g} samples a {group['unit']}"
    return f"{one['nanoseconds']:.3g} ns a {group['unit']}"


def conditions(found: dict[str, Any]) -> str:
    """On what was measured, as a sentence."""
    facts = found["conditions"]
    versions = ", ".join(f"{name} {version}" for name, version in facts["versions"].items())
    return (
        f"{facts['processor']}, {facts['cores']} cores; {versions}; {facts['rounds']} rounds; frame "
        f"{facts['width']} x {facts['height']}, {facts['pixels']:,} pixels. The machine's pace differed by "
        f"{found['pace_noise']:.0%} (95 %) from group to group."
    )


def agreement(one: dict[str, Any], other: dict[str, Any]) -> str:
    """How many times of two runs differ by less than their noise, with and without the pace's."""
    first, second = rows(one), rows(other)
    paces = one["pace_noise"] ** 2 + other["pace_noise"] ** 2
    within, with_pace, errors, off = 0, 0, 0, []
    for key, row in first.items():
        again = second[key]
        apart = abs(row["nanoseconds"] / again["nanoseconds"] - 1)
        off.append(apart)
        noise = (row["time_noise"] ** 2 + again["time_noise"] ** 2) ** 0.5
        within += apart <= noise
        with_pace += apart <= (noise**2 + paces) ** 0.5
        errors += row["error"] == again["error"]
    number = len(first)
    return (
        f"Of {number} times of two runs of `--quick` {with_pace / number:.1%} lie within the noise between "
        "runs, and "
        f"{within / number:.1%} within the noise in each alone; {errors / number:.1%} of the errors are the "
        "same to the last bit. Times differ by "
        f"{np.median(off):.0%} in the median and {np.quantile(off, 0.95):.0%} in one of twenty; the "
        f"machine's pace differed by {one['pace_noise']:.0%} and {other['pace_noise']:.0%} from group to "
        "group, so that the first is no hard test here."
    )


def needs(found: dict[str, Any]) -> str:
    lines = []
    for row in found["studies"]["scene_needs"]["rows"]:
        lines.append(
            {
                "profile": str(row["profile"]),
                "feature": row["feature"],
                "verdict": row["verdict"],
                "in the default": row["in the default"],
                "error with": f"{row['error with']:.4f}",
                "error without": f"{row['error without']:.4f}",
                "± of the loss": f"{row['loss, ±']:.4f}",
                "time with / without": f"{row['time with / without']:.2f}",
            }
        )
    return frames_data.table(lines, 3)


def on_frames(folders: list[str]) -> str:
    """The cost model's error on frames that were given."""
    lines = []
    for folder in folders:
        found = load(folder)
        facts, study = found["conditions"], found["studies"]["cost_model"]
        times = [row["measured, ms"] for row in study["rows"] if row["used"] == "unseen"]
        lines.append(
            {
                "frame": f"`{Path(folder).name}`",
                "size": f"{facts['width']} x {facts['height']}",
                "scattering pixels": f"{facts['pixels']:,}",
                "measured, ms": f"{min(times):.0f} to {max(times):.0f}",
                "median error, %": f"{100 * study['facts']['median_error_unseen']:.0f}",
                "largest error, %": f"{100 * study['facts']['largest_error_unseen']:.0f}",
            }
        )
    return frames_data.table(lines, 1)


def main() -> None:
    found = load(sys.argv[1])
    page.replace(PAGE, "trade machine", conditions(found))
    page.replace(PAGE, "trade overview", overview(found))
    page.replace(
        PAGE, "trade cost", "\n".join(f"- {one}" for one in found["studies"]["cost_model"]["sentences"])
    )
    page.replace(PAGE, "trade needs", needs(found))
    for name in SHOWN:
        shutil.copy(Path(sys.argv[1]) / f"{name}.png", frames_data.DOCS / "images" / f"trade_{name}.png")
    page.replace(PAGE, "trade agreement", agreement(load(sys.argv[2]), load(sys.argv[3])))
    page.replace(PAGE, "trade cost frames", on_frames(sys.argv[4:]))
    page.replace(PAGE, "trade needs frames", needs(load(sys.argv[4])))


if __name__ == "__main__":
    main()
