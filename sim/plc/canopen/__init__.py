"""The PLC as a CANopen node: an object dictionary over the process image, SDO server, PDOs, NMT, EMCY."""
