"""Campaigns: many runs on virtual time, in processes of this machine or on a cluster."""
