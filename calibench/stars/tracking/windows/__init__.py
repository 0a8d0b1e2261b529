"""Centroids in windows about predicted places."""
