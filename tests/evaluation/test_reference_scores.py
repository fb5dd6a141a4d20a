"""Our scores beside those of the scenes' own scorer, on tracks with every kind of fault."""

from __future__ import annotations

import json
import math
from functools import cache
from pathlib import Path

import pytest

from service.evaluation.recorded import read_changes, read_crossings, read_lanes, read_tracks
from service.evaluation.scores import score
from service.evaluation.truth import Scene, read_scene
from tests.evaluation import reference_tracks

ROOT = Path(__file__).parents[2]
SCENES = ROOT.parent / "shared" / "scenes" / "data"
EXPECTED = ROOT / "tests" / "data" / "evaluation"

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not SCENES.is_dir(), reason="the recorded scenes are not on this machine"),
]


OWN = {"length_mae_m"}  # scores that the reference does not have


@cache
def truth_of(scene: str) -> reference_tracks.Truth:
    return reference_tracks.read(SCENES / scene)


@cache
def scene_of(scene: str) -> Scene:
    return read_scene(SCENES / scene)


@pytest.mark.parametrize("variant", reference_tracks.VARIANTS)
@pytest.mark.parametrize("scene", reference_tracks.SCENES)
def test_every_score_agrees_with_the_reference(scene, variant, tmp_path):
    expected = json.loads((EXPECTED / f"reference_scores_{scene}.json").read_text())[variant]
    files = reference_tracks.write(truth_of(scene), variant, tmp_path)
    whole = scene_of(scene)
    until = reference_tracks.UNTIL_S.get(variant)
    part = whole if until is None else whole.until(until)

    scores = score(
        part,
        read_tracks(files["tracks"], part),
        crossings=read_crossings(files["flow"], part) if "flow" in files else None,
        lanes=read_lanes(files["lanes"]) if "lanes" in files else None,
        changes=read_changes(files["changes"], part) if "changes" in files else None,
    )

    assert [key for key in scores if key not in OWN] == list(expected)
    for key, value in expected.items():
        found = scores[key]
        if value is None:
            assert math.isnan(found), key
        elif isinstance(value, str):
            assert found == value, key
        else:
            assert found == pytest.approx(value, rel=0, abs=1e-9), key  # the order of sums may differ
