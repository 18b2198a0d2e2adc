"""The loop from the historian back to the model: cycles cut and rated, learned anew, proven, proposed, looked after."""
