"""The sentence that says why, for every kind of evidence."""

from dataclasses import replace

import numpy as np
import pytest
from shared_data import ROOT

from adagmm_fusion.pairs.diagnosis import Evidence, diagnosis
from adagmm_fusion.pairs.pipeline import register_pair
from adagmm_fusion.pairs.record import pair_record
from adagmm_fusion.pairs.settings import Settings
from adagmm_fusion.pairs.stages import Stage, color_correlation, worse_than_start
from adagmm_fusion.recordings.opening import open_recording


def stage(name: str, deg=None, mm=None, *, by="", overlap=0.8, contradicted=0.01, colors=0.9) -> Stage:
    return Stage(name, by, np.eye(4).tolist(), deg, mm, overlap, contradicted, colors)


RIGHT, OFF = stage("start", 1.1, 20.0, by="features"), stage("start", 40.0, 900.0, by="geometry")
ENDED_RIGHT, FAR = stage("end", 0.3, 8.0), stage("end", 6.0, 400.0)
FOUND = {"feature_inliers": 131, "feature_matches": 180, "overlap_truth": 0.8}
UNKNOWN = stage("start", by="geometry")
CASES = {
    "refused": (Evidence("failed", "a.png: no depth"), "not registered: a.png: no depth"),
    "mirrored": (
        Evidence("failed", "", OFF, FAR, mirrored=True),
        "one of the two sensors seems mirrored: their features agree only if one image is flipped left to right",
    ),
    "right": (
        Evidence("ok", "", RIGHT, ENDED_RIGHT, **FOUND),
        "started right (131 of 180 features agreed, 1.1° and 20 mm off) and ended right",
    ),
    "brought in": (
        Evidence("ok", "", OFF, ENDED_RIGHT),
        "started off (from the clouds alone, 40.0° and 900 mm off) and ended right",
    ),
    "worse within the limits": (
        Evidence("ok", "", RIGHT, stage("end", 2.1, 53.0), moved_mm=40.0, across=0.1, **FOUND),
        "started right (131 of 180 features agreed, 1.1° and 20 mm off) and ended worse, within the limits: it slid 40 "
        "mm along the surfaces",
    ),
    "slid": (
        Evidence(
            "failed", "", RIGHT, stage("end", 6.0, 400.0, colors=0.7, overlap=0.7), moved_mm=420.0, across=0.2, **FOUND
        ),
        "started right (131 of 180 features agreed, 1.1° and 20 mm off), then slid along the surfaces, 420 mm; colour "
        "contradicts (correlation 0.70 instead of 0.90)",
    ),
    "drifted": (
        Evidence("failed", "", replace(RIGHT, rotation_error_deg=4.0), FAR, moved_mm=420.0, across=0.9, **FOUND),
        "started nearly right (131 of 180 features agreed, 4.0° and 20 mm off), then drifted, 420 mm; the clouds meet "
        "as well there (overlap 0.80, at the start 0.80)",
    ),
    "features wrong": (
        Evidence("failed", "", replace(OFF, found_by="features"), stage("end", 70.0, 900.0, colors=0.1), **FOUND),
        "the features agree on a wrong pose (131 of 180 features agreed, 40.0° and 900 mm off); colour contradicts "
        "(correlation 0.10)",
    ),
    "two poses explain the clouds": (
        Evidence("failed", "", OFF, stage("end", 90.0, 900.0, overlap=0.31), overlap_truth=0.3),
        "overlap only 0.30 at the truth, and this pose explains the clouds as well",
    ),
    "the truth is wrong": (
        Evidence(
            "failed",
            "",
            stage("start", 54.0, 900.0, by="features"),
            stage("end", 54.0, 900.0, overlap=0.66),
            overlap_truth=0.03,
        ),
        "the given pose does not fit the images: overlap 0.03 there and 0.66 here, where nothing speaks against; are "
        "the recording's poses, or its rig, right?",
    ),
    "contradicted": (
        Evidence("failed", "", OFF, stage("end", 90.0, 900.0, overlap=0.3, contradicted=0.4), overlap_truth=0.8),
        "started off (from the clouds alone, 40.0° and 900 mm off) and was not brought in; 40% of the source lies in "
        "front of the target's surfaces",
    ),
    "no truth, nothing against it": (
        Evidence("ok", "", UNKNOWN, stage("end")),
        "nothing speaks against it: overlap 0.80, 1% contradicted, colours correlate by 0.90",
    ),
    "no truth, ambiguous": (
        Evidence("failed", "x", UNKNOWN, stage("end", overlap=0.3), ambiguous=True),
        "two poses explain the clouds equally; overlap only 0.30",
    ),
    "no truth, free": (
        Evidence("failed", "x", UNKNOWN, stage("end"), free_directions=1, chance_fit=True),
        "the shape leaves 1 direction free; the clouds explain each other no better than by chance",
    ),
    "no truth, left the features": (
        Evidence("failed", "x", stage("start", by="features"), stage("end"), moved_mm=300.0, feature_inliers=40),
        "it left the pose that 40 features agree on by 300 mm",
    ),
    "no truth, depth contradicts the features": (
        Evidence("ok", "", stage("start", by="features"), stage("end"), feature_inliers=306, agreeing_features=1),
        "306 image features agreed at the start, 1 at the end: colour and depth contradict each other",
    ),
    "no truth, the features agree": (
        Evidence("ok", "", stage("start", by="features"), stage("end"), feature_inliers=306, agreeing_features=305),
        "nothing speaks against it: overlap 0.80, 1% contradicted, colours correlate by 0.90",
    ),
    "no truth, unsettled": (Evidence("failed", "x", UNKNOWN, stage("end"), converged=False), "it had not come to rest"),
    "no truth, only a reason": (Evidence("failed", "heavy noise", UNKNOWN, stage("end")), "heavy noise"),
}


@pytest.mark.parametrize("case", CASES)
def test_the_sentence_follows_from_the_evidence(case):
    evidence, expected = CASES[case]
    assert diagnosis(evidence) == expected


def test_an_end_is_worse_by_its_angle_or_its_distance():
    start = stage("start", 1.0, 20.0)
    for end, worse in (((0.5, 10.0), False), ((1.1, 25.0), False), ((1.5, 10.0), True), ((0.5, 40.0), True)):
        assert worse_than_start(start, stage("end", *end)) == worse
    assert not worse_than_start(stage("start"), stage("end"))


def test_correlation_of_colors_ignores_exposure_and_white_balance():
    rng = np.random.default_rng(5)
    colors = rng.uniform(size=(200, 3))
    darker = 0.4 * colors + 0.1
    assert color_correlation(colors, darker) == pytest.approx(1.0, rel=0, abs=1e-12)
    assert abs(color_correlation(colors, rng.permutation(colors))) < 0.25
    assert color_correlation(colors, np.full((200, 3), 0.5)) is None
    assert color_correlation(colors[:10], colors[:10]) is None


@pytest.mark.slow
def test_a_registered_pair_has_its_stages_and_its_diagnosis():
    settings = Settings(target_points=1200, device="cpu")
    record = pair_record(register_pair(open_recording(ROOT / "recordings" / "two_kinects")[0], settings), settings)
    identity, start, end = record.stages
    assert [s.title for s in record.stages] == ["identity", "start (features)", "end"]
    assert identity.rotation_error_deg == record.initial_rotation_error_deg
    assert end.rotation_error_deg == record.rotation_error_deg and end.overlap == record.overlap
    assert start.rotation_error_deg < 1.0 < identity.rotation_error_deg
    assert identity.contradicted > 0.05 > end.contradicted == record.contradicted
    assert identity.color_correlation < 0.5 < end.color_correlation
    words = f"started right ({record.feature_inliers} of {record.feature_matches} features agreed, "
    assert record.diagnosis.startswith(words)
