import numpy as np

from calibench.spots.cut import cut


def test_windows_are_cut_as_numpy_pads():
    image = np.arange(70, dtype=np.float32).reshape(7, 10)
    centre = np.array([[0, 0], [9, 6], [4, 3], [-5, 2]])
    padded = np.pad(image, 10, constant_values=-1)
    wanted = [padded[y + 8:y + 13, x + 8:x + 13] for x, y in centre]
    np.testing.assert_array_equal(cut(image, centre, 2, np.float32(-1)), wanted)
