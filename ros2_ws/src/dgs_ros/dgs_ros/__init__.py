"""What every node needs: base node, parameters, diagnostics, messages <-> numpy."""
