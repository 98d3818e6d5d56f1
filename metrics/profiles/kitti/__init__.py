"""KITTI's object benchmark (`object`) and 3D tracking as AB3DMOT evaluates it (`tracking`)."""
