"""From scene files and meshes to a scene."""
