"""Error against cost: every solver on easy and hard scenes, side by side, and throughput over the batch."""
