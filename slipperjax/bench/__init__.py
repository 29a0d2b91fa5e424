"""Error against cost: every solver on easy and hard scenes, beside other codes that integrate the same model."""
