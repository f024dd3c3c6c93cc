"""Metadata that were edited or do not fit the numbers are refused."""

import json

import pytest

from sssfit.tables.formats.metadata import metadata_digest

REMEDY = "; restore the file or write the table again"
CHANGED = "values were changed: they disagree with the content_sha256" + REMEDY


def edit_metadata(path, change, renew_digest=True):
    """Change the metadata of a texture, as a careful editor would when the digest is renewed."""
    beside = path.with_name(path.name + ".json")
    metadata = json.loads(beside.read_text(encoding="utf-8"))
    change(metadata)
    if renew_digest:
        metadata["metadata_sha256"] = metadata_digest(metadata)
    beside.write_text(json.dumps(metadata), encoding="utf-8")
    return beside


def test_metadata_edited(refusal_of, tmp_path, make_table, write_table):
    path = write_table(make_table(), "dds", tmp_path)

    def change(metadata):
        metadata["parameters"]["albedo"] = [0.1]

    beside = edit_metadata(path, change, renew_digest=False)
    problem = "was edited: it disagrees with its own metadata_sha256"
    assert refusal_of(path) == f"{beside}: {problem}{REMEDY}"


@pytest.mark.parametrize(
    "change, problem",
    [
        (lambda m: m.pop("format"), "is not of a sssfit table"),
        (lambda m: m.update(format_version=2), "format version 2 is not known, only 1"),
        (lambda m: m.pop("unit"), "entry 'unit' is missing or is no str"),
        (lambda m: m.update(channels="RGB"), "entry 'channels' is missing or is no list"),
        (lambda m: m.update(channels=[1, 2, 3]), "a channel has no name"),
        (lambda m: m.update(dtype="double"), "dtype 'double' is not one of half, float, 8-bit"),
        (lambda m: m.update(axes=[]), "a table has one or two axes, not 0"),
        (lambda m: m["axes"][0].pop("name"), "an axis has no name"),
        (lambda m: m["axes"][0].pop("unit"), "axis 'thickness' has no unit"),
        (lambda m: m["axes"][0].update(size=9), "axis 'thickness' holds 7 values but its size is"),
        (lambda m: m["axes"][0].update(values=["a"]), "has values that are no numbers"),
        (lambda m: m["axes"][0].pop("values"), "axis 'thickness' holds 1 values but its size"),
        (lambda m: m["axes"][0].update(size=2, values=[0, 1]), "7 x 1 pixels but the metadata say"),
        (lambda m: m.update(dtype="float"), "values are float16 but the metadata say 'float'"),
        (lambda m: m["channels"].append("A"), CHANGED),
        (lambda m: m["channels"].pop(), "channels beyond the first 2 are not 0, 0, 1"),
        (lambda m: m.update(content_sha256="0"), CHANGED),
    ],
)
def test_metadata_that_disagree(refusal_of, tmp_path, make_table, write_table, change, problem):
    path = write_table(make_table(), "dds", tmp_path)
    beside = edit_metadata(path, change)
    message = refusal_of(path)
    assert message.startswith((f"{path}: ", f"{beside}: ")) and problem in message
