"""Steps of road detection: seed area, texture, priors, fusion, trust, ego car, smoothing."""
