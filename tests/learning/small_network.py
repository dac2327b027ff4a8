"""A network small enough to train inside a test, for the environment of `fake_env`."""

from __future__ import annotations

from densecavoid.policy.network import ConvConfig, NetworkConfig

TINY = NetworkConfig(
    name="tiny",
    lidar_layers=(ConvConfig(4, (8,), (8,)),),
    lidar_features=(8,),
    camera_layers=(ConvConfig(4, (4, 4), (4, 4)),),
    camera_features=(8,),
    head_features=32,
    goal_direction=True,
    lidar_falloff=0.0,
    state_gain=1.0,
    shared_encoder=True,
    num_rays=16,
    image_size=(4, 8),
    min_std=(0.05, 0.05),
)
