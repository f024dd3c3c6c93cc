"""Measure whole frames on rendered scenes: the tables and pictures of docs/frames.md, "On rendered scenes".

Run from the repository root, all studies in some twenty minutes on two cores, or some of them:

    python docs/scripts/frames_studies.py [beam] [importance] [methods] [spp] [prefilter] [split]

and of docs/sequences.md, in some fifty minutes more: [flash] [static] [segments] [delivered] [moving]
[cold] [half] [taa] [jitter]
"""

import sys
import time

import frames_accuracy
import frames_data
import frames_delivered
import frames_histories
import frames_jitter
import frames_moving
import frames_sampling
import frames_sequences
import frames_taa

STUDIES = (
    frames_accuracy.STUDIES
    | frames_sampling.STUDIES
    | frames_sequences.STUDIES
    | frames_delivered.STUDIES
    | frames_moving.STUDIES
    | frames_histories.STUDIES
    | frames_taa.STUDIES
    | frames_jitter.STUDIES
)


def main() -> None:
    if not frames_data.FOLDER.is_dir():
        print(f"Nothing is measured: no scenes in {frames_data.FOLDER}; see SSSFIT_FRAMES.")
        return
    for name in sys.argv[1:] or STUDIES:
        start = time.perf_counter()
        STUDIES[name]()
        print(f"{name}: {time.perf_counter() - start:.0f} s, commit {frames_data.commit()}", flush=True)


if __name__ == "__main__":
    main()
