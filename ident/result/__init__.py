"""The result of an identification: result.json and the model in it."""
