"""What an identification leaves behind: result.json and the model in it."""
