"""Kinematics of the arm: rigid transforms, great circles, joints from poses."""
