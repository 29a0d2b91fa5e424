"""Studies: published work reproduced, one package each."""
