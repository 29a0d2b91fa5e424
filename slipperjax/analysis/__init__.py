"""What one does with trajectories."""
