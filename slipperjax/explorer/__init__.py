"""A page in the browser: click a point of a map and see how that slipper moves."""
