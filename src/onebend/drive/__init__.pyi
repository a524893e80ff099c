from .machine import Drive as Drive, DriveState as DriveState, GoalOutcome as GoalOutcome, Happened as Happened
from .placing import Placement as Placement, from_recording as from_recording, stated_placement as stated_placement
from .plan import (
    DriveLimits as DriveLimits,
    DrivePlan as DrivePlan,
    DriveSettings as DriveSettings,
    PlannedGoal as PlannedGoal,
    make_plan as make_plan,
)
from .robots import (
    ArmState as ArmState,
    Robot as Robot,
    ToolForce as ToolForce,
    ToolPose as ToolPose,
)
from .run import DriveOutcome as DriveOutcome, drive as drive
from .specs import camera_of as camera_of, force_of as force_of, robot_of as robot_of

COMMANDS: dict[str, object]
