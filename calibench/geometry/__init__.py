"""Projection, rotations and the sphere. Pixel (0, 0) is a pixel's centre; v_cam = R_cam_icrs @ v_icrs."""
