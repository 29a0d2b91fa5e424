"""Stores: results of sweeps on disk, made by one machine or many, resumed after anything."""
