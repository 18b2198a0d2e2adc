"""The names that commands had in the last release, and what is typed for them now."""

FORMER = {
    "status": "top --once",
    "backup": "keep backup",
    "restore": "keep restore",
    "support": "keep support",
    "config": "keep",
    "plc arm": "arm",
    "plc disarm": "disarm",
    "plc audit": "audit",
    "plc plan": "plc check plan",
    "plc verify": "plc check hmi",
    "plc soak": "plc check soak",
    "plc test": "plc check write",
    "model prove": "model judge proof",
    "model skill": "model judge skill",
    "model validate": "model judge validation",
    "model rank": "model judge rank",
    "model regress": "model judge regression",
    "model retrain": "model version retrain",
    "model shadow": "model version shadow",
    "model promote": "model version promote",
    "model lineage": "model version lineage",
}
"""Former words -> the words of today; what followed the former ones follows these. For one release."""
