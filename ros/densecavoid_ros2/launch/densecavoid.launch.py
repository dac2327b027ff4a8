"""ros2 launch densecavoid_ros2 densecavoid.launch.py folder:=/home/robot/exported robot:=turtlebot4"""

# pyright: reportMissingImports=false

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

ARGUMENTS = {
    "folder": ("exported", "what `densecavoid export` wrote"),
    "robot": ("turtlebot2", "settings: a robot that ships, or a YAML file"),
    "scan": ("scan", "topic of the scans"),
    "depth_image": ("camera/depth/image_raw", "topic of the depth images"),
    "camera_info": ("camera/depth/camera_info", "topic of the depth camera's calibration"),
    "odom": ("odom", "topic of the odometry"),
    "cmd_vel": ("commands/velocity", "topic of the commands (Kobuki); cmd_vel on most other robots"),
    "use_sim_time": ("false", "stamps are a simulator's"),
}


def generate_launch_description() -> LaunchDescription:
    value = {name: LaunchConfiguration(name) for name in ARGUMENTS}
    node = Node(
        package="densecavoid_ros2",
        executable="densecavoid_node",
        name="densecavoid",
        output="screen",
        respawn=True,
        respawn_delay=1.0,
        parameters=[{name: value[name] for name in ("folder", "robot", "use_sim_time")}],
        remappings=[
            ("scan", value["scan"]),
            ("depth/image", value["depth_image"]),
            ("depth/camera_info", value["camera_info"]),
            ("odom", value["odom"]),
            ("cmd_vel", value["cmd_vel"]),
        ],
    )
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, node])
