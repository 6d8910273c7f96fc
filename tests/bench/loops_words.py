"""What the page of `tests.bench.loops` says in words beside its tables."""

FINDINGS = """\
- **A gain that is computed without a drive tells nothing about a robot with position servos**, and little about one
  with delay. Dead time alone is enough only if the servo is fast compared with it.
- **The limit of a position servo is k_v over the inertia of the direction that oscillates**, at any rate. The
  diagonal of the inertia is smaller than that of this direction, so the computed limit is up to 23 % too large on the
  UR5 while delay is short. With the largest eigenvalue of k_v⁻¹M instead ("modes") it is right within 8 % for the
  position servos of both arms of six joints. The rest is growth too slow for the runs.
- **Velocity servos**: with their lag the limit is right within 15 % from two samples of delay on. With less delay
  MuJoCo's own step shows: it moves half a step of the physics earlier than a held command does, a quarter of a sample
  at 500 Hz. With steps of 0.1 ms the same prediction is right within 6 %.
- **A drive fitted to recorded steps** of one joint at a time does not know the coupling, which also distorts the
  recorded step. A step of all joints at once shows the UR5's coupling (0.92 to 0.99 of the position servos' limits).
  But joints that swing against each other look lighter then: on the Panda this fit alone gives up to 2.6 times too
  large a limit. The lower of the two limits is at most 16 % too high for position servos of all three arms. In the
  UR5's table it is within 15 %, except for velocity servos without delay, where it is too low. With a slow velocity
  servo and little delay it is up to 34 % too high (Panda), because lag and dead time look alike. Each cell in which
  the first fit is off by more than 15 % is listed below with its reason.
- **Stable is not yet without overshoot**: with the menagerie's position servos (k_p/k_v = 5 1/s) and measured
  feedback no gain above 1.9 1/s is without overshoot, at any rate, while 116 1/s is still stable. The coupled
  equations predict this to a percent, drives for each joint alone within a quarter.
"""

CALM = """\
Median (worst) over robots and delays of a gain over the measured one, at which the tip overshoots by 1 %. *Delay*,
*own drives* and *fitted* are cnclik's fastest gain, at which the slowest factor becomes complex: critical damping,
which comes earlier. *In time*: gains at which the tip of the linear loop overshoots by 1 %.
"""

LAG = """\
Largest gains, and the lag of the tip behind a ramp without feed-forward, measured and predicted with the joints' own
drives. *Measured* feedback: the lag is 1/alpha for any drive. *Commanded*: the loop has the kinematic limit 2/Ts for
any drive, and the tip lags by 1/alpha and the delay of the drive (half a sample less for position commands).
*Rebased*: each position command begins at the measured joints, so a servo is never more than one step ahead. For the
same lag gains may be, and must be, many times larger; this explains loops that "do not arrive".
"""

FINE = """\
Velocity servos at 500 Hz with the physics ten times finer.
"""

TOOLS = """\
`python -m tests.bench.loops --only tools` applies each of `Gains.elsewhere` to a Panda whose joints follow
through the drive of the case. pink, mink and Placo run themselves, with a posture task 0.2 rad away along the null
space. Isaac Lab's differential IK, MoveIt Servo's pose tracking and a loop around servoj are copies after their
sources and manuals. Placo brings its own Pinocchio: its rows need an environment in which it was installed last.
"Nothing said": the robot has the assumed drives. Isaac Lab has no row if there is no gain for it, as with dead time
alone. A posture task with its default gain of 1 diverges, and a servoj loop that begins at the measured joints does
not arrive.
"""

ADVICE = """\
`python -m tests.bench.loops --only advice` runs four arms in MuJoCo. Servos are "position 5, 10, 50" with that
k_p/k_v [1/s] (5 and 10 as the UR5e and Panda of the menagerie), servos of ζ = 0.4, and velocity servos with k_v of
400 and 40 and with integral parts. Some cells add dry friction of 1 and 0.2 N m and viscous friction; encoders of 15
bits; torque of at most 80 and 15 N m; motion that is 0.95 or 1.08 of its command; or several of these. Each cell
records a step of all joints (1.2 s, at most 200 rows), fits the drive, and runs a step of 3 cm and 60 mrad for 3 s.
*Beyond*: the overshoot of the tip as a share of the step. *Of best*: the recommended gain over the largest with at
most 1 % overshoot. *Nothing said*: the gain that is recommended for unknown drives. With rebased feedback no gain is
given then, and none if the motion differs from its command (a gain other than 1), because the difference adds up from
step to step.
"""

REBASED = """\
`python -m tests.bench.loops --only rebased` runs underdamped servos (ζ about 0.4, k_v/k_p of 31 and 14 ms) at 100 Hz
with rebased feedback. In theory they are unstable at small gains from τ = (2π − arccos(4ζ² − 1))/(ω₀√(2 − 4ζ²)) on.
This is 64 ms for the lightest of these joints, 5 ms of it by the hold: more than 5.9 samples of delay. No gain is
given if one more sample, or half or twice the inertia, is beyond that. *Else calm*: of ten gains from alpha·Ts = 0.02
to 1 those that were stable for 8 s, arrived and did not overshoot. At 5 and 6 samples smaller gains are slow; at 7
and 8 they diverge. If a null space, damping or a limit reduces a larger gain, the loop behaves as with a small one.
"""

NAMES = """\
Gains are alpha in 1/s, delays samples of the controller, ratios predicted over measured. The models of the drives:

- *kinematic*: no drive. *delay*: dead time alone.
- *lag*: a first-order lag for each joint, m/k_v of a velocity servo and k_v/k_p of a position servo.
- *second order*: for each joint ω₀² = k_p/m and 2ζω₀ = k_v/m, with m the diagonal of the inertia in this posture.
- *modes*: the same with the eigenvalues of k_v⁻¹M in place of the diagonal. These rows have arms of six joints, where
  the loop is the same for every direction of the joints.
- *fitted*: dead time and lag, or ω₀ and ζ, of each joint, estimated from a recorded step of each joint while the
  others hold. *together*: the same from one step of all joints at once.
- *equations*: not cnclik, but the coupled linear equations in MuJoCo's own steps, run in time.
"""

METHOD = """\
MuJoCo has URDF files without shapes, no gravity, contact, friction or limit of effort, armature 0.1 kg m², and steps
of 1 ms (implicitfast). Servos "position" have k_p 2000 and k_v 400 (first three joints), 500 and 100 (others),
"stiff" has ten times the k_p. The same pose loop (J#, explicit Euler) runs at each rate, with the target 0.5 mm and 1
mrad away, feedback of the measured joints, and commands that add up. At the largest gain the envelope of the error
begins to grow in the last sixth of a run, found by bisection. No overshoot means that the tip goes at most 1 %
beyond. With the files' limits of effort a stiff loop near its limit oscillates without growing or settling; this page
does not cover that.
"""
