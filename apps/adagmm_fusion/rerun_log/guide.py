"""The page "How to read this"."""

import rerun as rr

from adagmm_fusion.rerun_log import entities
from adagmm_fusion.rerun_log.words import markdown

GUIDE = """### How to read this

**Colours.** Target blue, source orange. Cameras: target white, start blue, estimate orange, ground truth green.
Red is bad: a failed pair, or one that ended worse than it started.

**Stages.** Every pair has three, under one name here, in report.md and in report.json:

- *identity*: the source as it was recorded
- *start*: where the registration began, by the *features* of the two colour images or by the *geometry* of the
  clouds alone
- *end*: after registration

**Time.** `frame` changes the pair, `em_step` (of a single pair: `iteration`) runs through the EM iterations,
`recorded at` and `recorded after` are the sensor's own time stamps where the recording has them. The marker in
the plots is where you are.

**Plots.** Errors and spread stand on a logarithmic axis: 0 is 1° or 1 mm, 1 is ten, −1 a tenth.

**Words.**

- *overlap*: share of the source's points that have a point of the target within the partner distance
- *contradicted*: share in front of what the target's depth image shows: it looks through that place
- *out of sight*: outside the target's image or behind what it sees; it says nothing
- *colour*: correlation of the partners' brightness; 0.6 and more at right poses, about 0 at wrong ones;
  exposure and white balance do not change it
- *partners it believes in*: the registration's own estimate, without regard to the partner distance
- *spread*: standard deviation of a point, as the registration takes it; it shrinks as the clouds come together.
  Ellipsoids are three standard deviations

**Points.** Click on one: the panel on the right (top right button) tells its weight, residual, partner
(−1: none) and variance. Features in the images tell how many pixels the end is off at them.

**Fused sequences.** Registrations between frames are grey where they agree with the poses, yellow where they are
0.25 m off; blue ones are believed only because several say the same; red ones contradict the others, and the pose
graph dropped them.

**Why.** *Who pulls*: dark points count for nothing, bright ones decide. *How far off*: green to red, grey
without partner. *Who has a partner*: green has one, grey is out of sight, red is contradicted.
*What colour says*: green for a point's partners, red against them, grey where colours do not count. Red areas that
hang together mean a wrong pose; single red points are noise. If the pose is right, the checkerboard's edges
meet.
"""


def log_guide(rec: rr.RecordingStream) -> None:
    """Log the page, once."""
    rec.log(entities.GUIDE, markdown(GUIDE), static=True)
