"""Open folder of attitude methods: `attitude(camera (N, 3), sky (N, 3), weights (N,)) -> R_cam_icrs (3, 3)`.

Wahba's problem: the rotation that minimises sum of weight |camera - R sky|^2. All answer in our convention (v_cam = R v_icrs);
the papers' quaternion is the conjugate of ours and is converted where it is made. `effective_weights(camera, weights)` are the
weights under which the method's answer solves Wahba's problem: those given, except where a method leaves stars out.
"""
