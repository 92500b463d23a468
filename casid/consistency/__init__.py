"""Whether records can be what they are said to be: units, time, rigid-body kinematics."""
