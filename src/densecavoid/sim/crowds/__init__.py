"""How people move: what they intend (scripted, recorded) and how they steer around each other, walls and the robot."""
