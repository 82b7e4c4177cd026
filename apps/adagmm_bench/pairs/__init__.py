"""Pairs of clouds as people bring them: recorded ones, public ones, parts that share less and less, unrelated ones."""
