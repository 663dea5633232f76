"""Steps that say where road is: seed area, texture, priors, fusion, trust, ego car, steadying."""
