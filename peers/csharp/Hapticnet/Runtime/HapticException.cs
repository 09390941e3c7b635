using System;

namespace Hapticnet
{
    /// <summary>What was wrong with a request, a key, a file or a link: one sentence for people.</summary>
    public sealed class HapticException : Exception
    {
        /// <summary>Make one with this sentence.</summary>
        public HapticException(string message)
            : base(message)
        {
        }
    }
}
