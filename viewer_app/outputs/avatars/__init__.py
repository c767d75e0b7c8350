"""S* as avatars take it: VMC and VRChat over OSC, in Unity's axes."""
