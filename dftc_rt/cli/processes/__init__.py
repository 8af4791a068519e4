"""The processes of a run on buses: launcher, controller, rig, recorder."""
