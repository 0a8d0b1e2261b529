"""Open folder of centroiders: `centroid(scene, candidates) -> Centroids`; Scene and Centroids stand in spots/scene.py."""
