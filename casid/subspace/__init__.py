"""Black boxes by predictor-based subspace identification: settings, realisation, refinement."""
