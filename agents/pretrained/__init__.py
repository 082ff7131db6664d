"""Trained policies that come with kfenv, a file for each environment; README.md has their cards."""
