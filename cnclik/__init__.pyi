"""What `cnclik` offers and where it is, for editors, type checkers and the loader."""

from . import (
    diagnosis as diagnosis, export as export, measure as measure, problem as problem,
    show as show, stability as stability, sweeps as sweeps, tuning as tuning,
)
from .cache import use_cache as use_cache
from .diagnosis.check import check_log as check_log
from .diagnosis.diagnose import diagnose as diagnose
from .diagnosis.fit import fit_drive as fit_drive
from .engine.native import native as native
from .engine.plan import use_engine as use_engine
from .errors import ArgumentError as ArgumentError
from .integrate.drive import Drive as Drive
from .integrate.lanes import lanes as lanes
from .integrate.method import METHODS as METHODS, Method as Method, exponential as exponential
from .integrate.solve import solve as solve, step as step
from .integrate.stage import chord as chord, newton as newton, picard as picard
from .integrate.status import Status as Status, require_ok as require_ok
from .law.bounded import bounded as bounded
from .law.inverse import (
    damped as damped, error_damped as error_damped, levels as levels, pseudoinverse as pseudoinverse,
    singular_damped as singular_damped,
)
from .law.law import Law as Law, posture as posture
from .law.limits import velocity_scaling as velocity_scaling
from .law.paths import (
    causal as causal, circle as circle, hold as hold, line as line,
    lissajous as lissajous, path as path, waypoints as waypoints,
)
from .law.reference import hold_at as hold_at, references as references
from .law.walls import wall as wall
from .problem.names import load as load
from .reaching.public import reach as reach
from .reaching.result import ReachStatus as ReachStatus
from .record import replace as replace
from .robot.builtin import panda as panda, ur5 as ur5
from .robot.chain import (
    from_dh as from_dh, planar_arm as planar_arm,
)
from .robot.exchange import from_model_q as from_model_q, to_model_q as to_model_q
from .robot.model import Pose as Pose, forward as forward, jacobian as jacobian
from .robot.mounted import join as join, with_base as with_base, with_tool as with_tool
from .robot.mjcf import load_mjcf as load_mjcf
from .robot.urdf import load_urdf as load_urdf
from .show.run import plot as plot
from .stability.advice import advise as advise
from .stability.ending import verdict as verdict
from .stability.gain import gains as gains
from .sweeps.sweep import sweep as sweep
from .task.build import center_of_mass as center_of_mass, com as com
from .task.build import (
    function as function, joints as joints, orientation as orientation, pose as pose, position as position,
    stack as stack,
)
from .task.shapes import capsule as capsule, distance as distance, sphere as sphere
from .tuning.tune import tune as tune
from .version import __version__ as __version__
