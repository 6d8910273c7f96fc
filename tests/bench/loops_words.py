"""What the page of `tests.bench.loops` says in words beside its tables."""

FINDINGS = """\
- **The gain without a drive says nothing of a robot with position servos**, and little of one with delay. Dead time
  alone is enough only where the servo is fast beside it.
- **What limits a position servo is k_v over the inertia of the direction that swings**, whatever the rate. The
  diagonal of the inertia is lighter than that direction: it names up to 23 % too much on the UR5 while delay is
  short. The largest eigenvalue of k_v⁻¹M in its place ("modes") is right within 8 % for the position servos of both
  arms of six joints; what is left there is growth too slow for the runs.
- **Velocity servos**: their lag is right within 15 % from two samples of delay on. Below that MuJoCo's own step is
  seen: it moves half a step of the physics earlier than a held command does, a quarter of a sample at 500 Hz. With
  steps of 0.1 ms the same prediction is right within 6 %.
- **A drive fitted to recorded steps** of one joint at a time knows no coupling, which also bends the step that it is
  fitted to. Stepped all at once the UR5's joints show it (0.92 to 0.99 of the position servos' limits), but joints
  that swing against each other look lighter so: on the Panda that fit alone names up to 2.6 times too much. The
  lower of the two limits is at most 16 % too high for position servos of all three arms, and within 15 % in the UR5's
  table but for velocity servos without delay, where it is too low. With a slow velocity servo and little delay even
  it is up to 34 % too high (Panda): lag and dead time are mistaken for each other. Each cell where the first fit is
  off by more than 15 % stands below with its reason.
- **Fast is not what is stable**: with the menagerie's position servos (k_p/k_v = 5 1/s) and measured feedback
  nothing above 1.9 1/s is without overshoot, at any rate, where 116 1/s is still stable. The coupled equations say
  it to the percent, drives of the joints' own within a quarter.
"""

CALM = """\
Median (worst) over robots and delays of a gain over the measured one, which is where the tip goes 1 % beyond.
*Delay*, *own drives* and *fitted* are cnclik's fastest gain, where the slowest factor becomes complex: with
critical damping, which is earlier. *In time*: gains at which the linear loop's tip goes 1 % beyond."""

LAG = """\
Largest gains and lag of the tip behind a ramp without feed-forward, measured and of the joints' own drives.
*Measured* feedback: 1/alpha, whatever the drive. *Commanded*: the loop has the kinematic limit 2/Ts whatever the
drive, and the tip is behind by 1/alpha and what the drive is late by (half a sample less where positions are
commanded). *Rebased*: each position command begins at the measured joints, so a servo never gets further than one
step ahead: gains must be, and may be, many times larger for the same lag, which explains loops that "do not
arrive"."""

FINE = """\
Velocity servos at 500 Hz with the physics ten times finer."""

TOOLS = """\
`python -m tests.bench.loops --only tools`. Each line of `Advice.settings` as it stands, on a Panda whose joints
follow through the drive of the case: pink, mink and Placo themselves, with a posture task 0.2 rad away along the null
space; of Isaac Lab's differential IK, MoveIt Servo's pose tracking and a loop around servoj copies of what their
sources and manuals say. Placo brings a Pinocchio of its own: its rows take an environment in which it was installed
last. "Nothing said": the robot has the drives that are assumed. Isaac Lab has no row where its line names no gain, as
with dead time alone. A posture task whose gain is left
at its default of 1 runs away, and a servoj loop that begins at the measured joints does not arrive.
"""

ADVICE = """\
`python -m tests.bench.loops --only advice`. Four arms in MuJoCo; servos "position 5, 10, 50" with that k_p/k_v [1/s]
(5 and 10 as the UR5e and Panda of the menagerie have it), of ζ = 0.4, velocity servos with k_v of 400 and 40 and with
integral parts. Besides: dry friction of 1 and 0.2 N m and viscous friction; encoders of 15 bits; torque of at most 80
and 15 N m; motion that is 0.95 or 1.08 of its command; or some of all. Each cell records a step of all joints (1.2 s,
at most 200 rows), fits the drive, and runs a step of 3 cm and 60 mrad for 3 s. *Beyond*: by how much of the step the
tip goes beyond its target. *Of best*: the recommended gain over the largest that goes at most 1 % beyond. *Nothing
said*: the gain that is recommended where nothing is known of the drives. Of rebased feedback none is named then, nor
where motion is not what is commanded (a gain other than 1): the difference adds up from step to step.
"""

REBASED = """\
`python -m tests.bench.loops --only rebased`. Underdamped servos (ζ about 0.4, k_v/k_p of 31 and 14 ms) at 100 Hz with
rebased feedback. At small gains theory has them unstable from τ = (2π − arccos(4ζ² − 1))/(ω₀√(2 − 4ζ²)) on,
64 ms for the lightest of these joints, of which the hold has 5 ms: more than 5.9 samples of delay. No gain is named
where a sample more, or half or twice the inertia, is beyond that. *Else calm*: of ten gains from alpha·Ts = 0.02 to 1
those that were stable for 8 s, arrived and did not overshoot. At 5 and 6 samples smaller ones are slow; at 7 and 8 they
run away, and where a null space, damping or a limit leaves little of a larger one the loop does as with a small one.
"""

NAMES = """\
Gains are alpha in 1/s, delays samples of the controller, ratios predicted over measured. Models: *kinematic* (no
drive), *delay* (dead time alone), *lag* (a first-order lag for each joint: m/k_v of a velocity servo, k_v/k_p of a
position servo), *second order* (for each joint ω₀² = k_p/m, 2ζω₀ = k_v/m, m the diagonal of the inertia in this
posture), *modes* (the same with the eigenvalues of k_v⁻¹M in place of the diagonal; arms of six joints, where the
loop is the same for every direction of the joints), *fitted* (dead time and lag, or ω₀ and ζ, of each joint
estimated from a recorded step of each joint while the others hold), *together* (the same of one step of all joints
at once), *equations* (not cnclik: the coupled linear equations in MuJoCo's own steps, run in time).
"""

METHOD = """\
MuJoCo: URDF files without shapes, no gravity, contact, friction or limit of effort, armature 0.1 kg m², steps of 1
ms (implicitfast), servos "position" with k_p 2000 and k_v 400 (first three joints), 500 and 100 (others), "stiff"
with ten times the k_p; the same pose loop (J#, explicit Euler) at each rate, the target 0.5 mm and 1 mrad away,
feedback of the measured joints with the command added up. The largest gain is where the envelope of the error grows
in the last sixth of a run, found by bisection; no overshoot means that the tip goes at most 1 % beyond. With the
files' limits of effort a stiff loop near its limit swings without growing or settling: that is no statement of this
page.
"""
