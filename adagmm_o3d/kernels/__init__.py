"""The pair loop: formulas once, loops per device, one pass over all pairs behind `PairLoop`."""
