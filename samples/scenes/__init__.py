"""Random photo scenes whose true shapes, cameras and other factors are known."""
