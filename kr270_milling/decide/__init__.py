"""Basis of a decision: findings, verdict, part."""
