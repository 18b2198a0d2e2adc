"""How good forecasts were: figures whose answer is known, and the gateway's forecasts along recorded traces."""
