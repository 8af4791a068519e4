"""Decentralised fault-tolerant control for any robot that a URDF describes.

Source: [zhao2017].
"""
