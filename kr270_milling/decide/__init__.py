"""What a person decides on: findings, verdict, part."""
