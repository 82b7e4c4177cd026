# %% [markdown]
# # My two Kinects, from photos to `verify`
#
# Two sensors look at one room. Photos of a chessboard say where they are; a recording of the room, registered without
# any board, says whether that is still true. The photos are drawn here, as two cameras of a known rig would take them,
# so that it can be seen how far everything is off; with photos of your own, start at *Calibrate*.

# %%
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np

from adagmm_fusion.rigs.rig import load_rig
from adagmm_o3d.evaluation import pose_errors

root = Path(__file__).resolve().parents[1] if "__file__" in globals() else Path.cwd().parent
recording = root / "recordings" / "two_kinects"
truth = load_rig(root / "calibration" / "two_kinects.yaml")
T_left_right = truth.T_target_source("left", "right")


def fusion(*arguments):
    """Run a command of the app, show what it prints, and return its exit code."""
    done = subprocess.run([sys.executable, "-m", "adagmm_fusion", *map(str, arguments)], capture_output=True, text=True)
    print(done.stdout + done.stderr)
    return done.returncode


# %% [markdown]
# ## Photos
#
# Eighteen times the board, 9 × 6 inner corners of 60 mm, where both sensors see it, tilted to all sides.

# %%
SQUARE, TEXELS = 0.060, 40
y, x = np.indices((9, 12))
board = np.where((x + y) % 2 == 0, 30, 220)
board[[0, -1], :] = board[:, [0, -1]] = 220
board = np.kron(board, np.ones((TEXELS, TEXELS))).astype(np.uint8)
T_board_texels = np.array([[SQUARE / TEXELS, 0, -2 * SQUARE], [0, SQUARE / TEXELS, -2 * SQUARE], [0, 0, 1]])


def photo(K, T_camera_board, size):
    """The board as a camera without distortion sees it."""
    onto_image = K @ T_camera_board[:3, [0, 1, 3]] @ T_board_texels
    scale = np.diag([4.0, 4.0, 1.0])  # drawn large, then made smaller, as pixels are no points
    centre = np.array([[1, 0, 1.5], [0, 1, 1.5], [0, 0, 1]])
    large = cv2.warpPerspective(board, centre @ scale @ onto_image, (4 * size[0], 4 * size[1]), borderValue=110)
    return cv2.resize(large, size, interpolation=cv2.INTER_AREA)


rng = np.random.default_rng(4)
middle = T_left_right[:3, 3] / 2 + (0.0, 0.0, 1.9)
for view in range(18):
    around = 2 * np.pi * view / 18
    turn, _ = cv2.Rodrigues(np.array([0.5 * np.cos(around), 0.5 * np.sin(around) - 0.25, rng.uniform(-0.3, 0.3)]))
    T_left_board = np.eye(4)
    T_left_board[:3, :3] = turn
    T_left_board[:3, 3] = middle + rng.uniform(-0.25, 0.25, 3) - turn @ (4 * SQUARE, 2.5 * SQUARE, 0)
    for name, T_camera_left in (("left", np.eye(4)), ("right", np.linalg.inv(T_left_right))):
        k = truth.sensor(name).intrinsics
        K = np.array([[k.fx, 0, k.cx], [0, k.fy, k.cy], [0, 0, 1]])
        folder = Path("desk") / name / "color"
        folder.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / f"{view:03}.png"), photo(K, T_camera_left @ T_left_board, (k.width, k.height)))

# %% [markdown]
# ## Calibrate

# %%
assert fusion("calibrate", "desk", "--chessboard", "9x6", "--square", SQUARE, "--output", "desk.yaml") == 0
calibrated = load_rig("desk.yaml").T_target_source("left", "right")
errors = pose_errors(T_left_right, calibrated)
print(f"the board's rig is {errors.rotation_deg:.2f} degrees and {1000 * errors.translation:.0f} mm off")

# %% [markdown]
# ## Register the room, without a board
#
# The board's rig is what the registrations are compared with. The Rerun recording shows each of them.

# %%
assert fusion("run", recording, "--calibration", "desk.yaml", "--no-clouds", "--output", "room") == 0
found = load_rig("room/rig.yaml").T_target_source("left", "right")
errors = pose_errors(T_left_right, found)
print(f"the room's rig is {errors.rotation_deg:.2f} degrees and {1000 * errors.translation:.0f} mm off")

# %% [markdown]
# ## Is it still true?
#
# Exit code 0: no sensor has moved. Then somebody bumps into the right one: 3.

# %%
assert fusion("verify", "desk.yaml", recording) == 0

# %%
rig = Path("desk.yaml").read_text(encoding="utf-8")
head, right = rig.split('"right":')
bump = np.array(calibrated)
bump[:3, :3] = cv2.Rodrigues(np.radians([0.0, 5.0, 0.0]))[0] @ bump[:3, :3]
rows = "".join(f"      - [{', '.join(map(repr, map(float, row)))}]\n" for row in bump)
Path("bumped.yaml").write_text(
    f'{head}"right":{right.split("T_rig_sensor:")[0]}T_rig_sensor:\n{rows}', encoding="utf-8"
)
assert fusion("verify", "bumped.yaml", recording) == 3
