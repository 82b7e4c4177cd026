"""One report of several recordings: the failing ones first, each bad pair with its reason."""

import json

from adagmm_fusion.pairs.joint_report import RecordingSummary, joint_markdown, write_joint_report


def pair(name: str, status: str = "ok", worse: bool = False, deg: float | None = 1.0, why: str = "slid") -> dict:
    errors = {"rotation_error_deg": deg, "worse_than_start": worse}
    return {"pair": name, "status": status, "reason": "too far", "diagnosis": why, **errors}


def summary(name: str, *pairs: dict) -> RecordingSummary:
    median = {"rotation_error_deg": 0.5, "translation_error_mm": 12.0}
    counts = {"ok": sum(p["status"] == "ok" for p in pairs), "pairs_done": len(pairs), "median": median}
    return RecordingSummary(name, name, {"pairs": list(pairs), "summary": counts})


RECORDINGS = [
    summary("fine", pair("a_to_b")),
    summary(
        "bad", pair("b_to_c", "ok", worse=True), pair("c_to_d", "failed", deg=9.0), pair("d_to_e", "failed", why="")
    ),
    RecordingSummary("gone", "gone", None, "no images"),
]


def test_those_that_failed_come_first_and_say_why():
    lines = joint_markdown("room", RECORDINGS).splitlines()
    rows = [line for line in lines if line.startswith("| ") and "recording" not in line]
    assert rows == ["| gone | – | – | – | – |", "| bad | 1 | 3 | 0.50 | 12 |", "| fine | 1 | 1 | 0.50 | 12 |"]
    assert [line for line in lines if line.startswith("- ")] == [
        "- × c_to_d: slid",
        "- × d_to_e: too far",
        "- worse than its start b_to_c: slid",
    ]
    assert "could not be run: no images" in lines and "## fine" not in lines


def test_json_names_the_bad_pairs(tmp_path):
    markdown, path = write_joint_report(tmp_path, "room", RECORDINGS)
    content = json.loads(path.read_text(encoding="utf-8"))
    assert content["schema"] == "adagmm-fusion-joint-report"
    assert [[p["pair"] for p in r["failed"]] for r in content["recordings"]] == [[], ["c_to_d", "d_to_e", "b_to_c"], []]
    assert markdown.read_text(encoding="utf-8") == joint_markdown("room", RECORDINGS)
