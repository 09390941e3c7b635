// A slave with a spring of 300 N/m behind 20 mm.
// First: SmallestSlave.exe [PORT]. Then: hapticnet master --connect 127.0.0.1:47800
using System;
using System.Threading;
using Hapticnet;

internal sealed class Spring : IScene
{
    public void Touch(double[] positionM, double[] forceN)
    {
        forceN[0] = Math.Max(0.0, 300.0 * (positionM[0] - 0.02));
    }
}

internal static class SmallestSlave
{
    private static int Main(string[] arguments)
    {
        int port = 47800;
        try
        {
            if (arguments.Length > 0 && !int.TryParse(arguments[0], out port))
                throw new HapticException("usage: SmallestSlave.exe [PORT]");
            var link = new SlaveLink("127.0.0.1", port, "spring", 1, new Spring());
            Console.WriteLine("listening on 127.0.0.1:" + link.Port);
        }
        catch (HapticException error)
        {
            Console.Error.WriteLine(error.Message);
            return 2;
        }
        Thread.Sleep(Timeout.Infinite);
        return 0;
    }
}
