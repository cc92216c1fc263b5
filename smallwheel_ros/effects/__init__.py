"""Physical effects that a model may lack, one file each; see `base` for how they act."""
