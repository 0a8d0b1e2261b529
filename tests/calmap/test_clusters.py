"""The flag `cluster`: which pixels touch a bad neighbour, against labelled components."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from calibench.calmap.clusters import with_clusters
from calibench.records import DEFECT_FLAGS, UNUSABLE


def test_clusters_are_the_components_of_two_pixels_or_more():
    rng = np.random.default_rng(1)
    defects = np.where(rng.random((60, 80)) < 0.08, DEFECT_FLAGS["hot"], 0).astype(np.uint16)
    label, count = ndimage.label(defects > 0, np.ones((3, 3)))
    sizes = ndimage.sum_labels(defects > 0, label, np.arange(count + 1))
    found = (with_clusters(defects) & DEFECT_FLAGS["cluster"]) != 0
    np.testing.assert_array_equal(found, (sizes[label] >= 2) & (label > 0))


def test_an_informing_flag_makes_no_cluster_and_a_cluster_blinds_nobody():
    defects = np.zeros((5, 5), np.uint16)
    defects[1, 1:3] = DEFECT_FLAGS["warm"]
    assert not (with_clusters(defects) & DEFECT_FLAGS["cluster"]).any()
    assert not UNUSABLE & DEFECT_FLAGS["cluster"]
    defects[3, 3] |= DEFECT_FLAGS["cluster"]  # a neighbour that healed
    assert not (with_clusters(defects) & DEFECT_FLAGS["cluster"]).any()
