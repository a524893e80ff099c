"""A ROS 2 launch file (Humble or newer): a camera's node, and onebend driving a beam with a Cartesian controller.

    ros2 launch examples/ros2/drive.launch.py model:=out/linear-beam goal:="0.1338 0.0638"   # shows the plan
    ros2 launch examples/ros2/drive.launch.py model:=out/linear-beam goal:="0.1338 0.0638" go:=--go

The robot's own launch file is started before: it brings a controller that takes PoseStamped on /target_frame, and says
where the tool is on /current_pose and what it feels on /wrench. ROS must use Cyclone DDS or another DDS:

    export RMW_IMPLEMENTATION=rmw_cyclonedds_cpp ROS_DOMAIN_ID=0
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "model": "out/linear-beam",  # what `onebend learn` left
    "like": "examples/linear-beam/train",  # a recording of this beam on this bench
    "out": "driven",
    "goal": "0.1338 0.0638",  # m, in the beam's frame
    "domain": "0",
    "go": "",  # --go: move
}


def generate_launch_description() -> LaunchDescription:
    """What `ros2 launch` asks for."""
    wanted = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    camera = Node(
        package="usb_cam",
        executable="usb_cam_node_exe",
        parameters=[{"image_width": 1280, "image_height": 720, "framerate": 30.0, "pixel_format": "mjpeg2rgb"}],
    )
    robot = ["--robot ros2:", wanted["domain"], ",pose_in=/current_pose,pose_out=/target_frame,frame=base_link"]
    eye = ["--camera ros2:", wanted["domain"], ",topic=/image_raw,qos=best_effort"]
    beam = ["onebend drive ", wanted["model"], " ", wanted["out"], " --like ", wanted["like"]]
    words = [*beam, " --goal ", wanted["goal"], " ", *eye, " ", *robot, " ", wanted["go"]]
    drive = ExecuteProcess(cmd=[words], shell=True, output="screen", emulate_tty=True)
    return LaunchDescription([*(DeclareLaunchArgument(name, default_value=value) for name, value in ARGUMENTS.items()),
                              camera, drive])  # fmt: skip
