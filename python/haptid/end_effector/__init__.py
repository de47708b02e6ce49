"""What the hand feels and does at the end-effector: torque decomposition, force estimation, apparent mass."""
