"""LeafSystems: thin plumbing around `massprop_drake.maths`, one file each."""
