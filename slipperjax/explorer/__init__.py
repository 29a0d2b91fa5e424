"""A page in the browser: click a point of a map to see the motion of this slipper."""
